"""Compensation: the coordinates to command so that the tool ends up where the ideal chain puts it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.chain import Chain
from model.error_map import ErrorMap
from model.exceptions import ComputeError, MachineError
from model.transforms import Array
from model.validation import did_you_mean

RESIDUAL_MM = 1e-6
"""What the exact chain's residual may be at most: 1 nm."""
CONVERGED_MM, CONVERGED_RAD = 1e-9, 1e-12
"""Where Newton stops: a thousandth of what is promised, which one further step usually costs."""
MAX_ITERATIONS = 30
ROTARY_ITERATIONS = 24
"""From then on the rotary axes rest, so that the linear ones can finish: near a pole, where the correction fades, a
knot of an error table can keep them swinging between its two sides for ever."""
CHUNK = 8192
"""Positions worked on at once, so that memory stays flat: about 30 MB for a machine of 42 terms."""
SINGULAR = 0.02
"""How far the tool axis turns per angle of the rotary axes, below which a pose counts as near singular. About a degree
beside the pole of a rotary table, there an orientation error of 1 mrad asks for 3 degrees of table; nearer, the
correction fades to none instead of growing without bound."""
SPANNED = 0.1
"""Least share of each direction that the linear axes must reach for the position to be fully theirs."""


@dataclass(frozen=True)
class Compensation:
    """Corrected coordinates of n positions.

    Attributes
    ----------
    corrected : shape (n, A), what to command [mm, degree]
    residual_mm : shape (n,), distance of the exact chain's tip from the ideal one after compensation
    tilt_rad : shape (n,), angle of the tool axis from the ideal one after compensation: what the machine has no
        rotary axis to remove, or too little of one near a singular pose
    outside : shape (n,), whether a corrected coordinate leaves its axis' range
    """

    corrected: Array
    residual_mm: Array
    tilt_rad: Array
    outside: NDArray[np.bool_]


def compensate(
    chain: Chain, q: Array, errors: ErrorMap, tool_mm: Array | None = None, keep: Sequence[str] = ()
) -> Compensation:
    """Find axis coordinates for which the erroneous chain puts the tool where the ideal chain puts it at q.

    Newton on the exact chain, position first: rotary axes turn the tool axis back as far as they can, linear axes
    then put the tip in its place. The Jacobian is the ideal chain's, plus the sensitivity times the slopes of the
    error terms, since the terms are functions of the corrected coordinates, too.

    Parameters
    ----------
    q : shape (n, A), programmed coordinates [mm, degree]
    errors : the error terms
    tool_mm : tool tip in the tool frame, shape (3,), by default the machine's
    keep : axes that must stay as programmed

    Raises
    ------
    ComputeError
        where the axes reach every direction and the residual does not fall to 1 nm; it names the position.
    MachineError
        where `keep` names an axis that the machine does not have.
    """
    names = chain.machine.axis_names
    for name in keep:
        if name not in names:
            raise MachineError(f"unknown axis '{name}' to keep" + did_you_mean(name, list(names)))
    solver = _Solver(chain, errors, tool_mm, keep)
    parts = [solver.solve(q[i : i + CHUNK]) for i in range(0, len(q), CHUNK)]
    parts = parts or [(np.empty_like(q), np.empty(0), np.empty(0))]
    corrected, residual, tilt = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    low = np.array([chain.machine.axes[a].low for a in names])
    high = np.array([chain.machine.axes[a].high for a in names])
    outside = np.logical_or(corrected < low, corrected > high)
    return Compensation(corrected, residual, tilt, np.logical_or.reduce(outside, axis=1))


class _Solver:
    """Newton for one chain, one error map and one tool."""

    def __init__(self, chain: Chain, errors: ErrorMap, tool_mm: Array | None, keep: Sequence[str]) -> None:
        self._chain, self._errors, self._tool_mm = chain, errors, tool_mm
        axes = [chain.machine.axes[a] for a in chain.machine.axis_names]
        self._linear = [i for i, a in enumerate(axes) if not a.rotary and a.name not in keep]
        self._rotary = [i for i, a in enumerate(axes) if a.rotary and a.name not in keep]
        self._per_rad = np.array([1.0 / axes[i].to_internal for i in self._rotary])
        self._along = np.asarray(chain.machine.tool.direction)
        self._terms = [
            (k, chain.machine.axis_names.index(term.axis))
            for k, term in enumerate(chain.machine.terms)
            if term.kind == "motion"
        ]

    def solve(self, q: Array) -> tuple[Array, Array, Array]:
        """Return corrected coordinates, residual and remaining tilt of a chunk."""
        wanted_tip, wanted = self._chain.pose(q, None, self._tool_mm)
        wanted_axis = wanted @ self._along
        corrected = q.copy()
        for iteration in range(MAX_ITERATIONS):
            tip, turned = self._chain.pose(corrected, self._errors.evaluate(corrected), self._tool_mm)
            miss = tip - wanted_tip
            tilt = np.cross(turned @ self._along, wanted_axis)  # turns the tool axis back, to first order
            step = self._step(q, corrected, miss, tilt, wanted_axis, resting=iteration >= ROTARY_ITERATIONS)
            residual: Array = np.linalg.norm(miss, axis=1)
            rotary = np.abs(step[:, self._rotary] / self._per_rad).max(initial=0.0)
            if np.abs(step[:, self._linear]).max(initial=0.0) <= CONVERGED_MM and rotary <= CONVERGED_RAD:
                break
            corrected = corrected + step
        self._check(q, residual)
        return corrected, residual, np.arcsin(np.clip(np.linalg.norm(tilt, axis=1), 0.0, 1.0))

    def _step(
        self, q: Array, corrected: Array, miss: Array, tilt: Array, wanted_axis: Array, *, resting: bool
    ) -> Array:
        """Return how to change the coordinates, shape (n, A)."""
        jacobian = self._jacobian(corrected)
        step = np.zeros_like(q)
        if self._rotary and not resting:
            by_rad = jacobian[:, 3:, self._rotary] * self._per_rad
            by_rad = by_rad - wanted_axis[..., None] * (wanted_axis[:, None, :] @ by_rad)  # turns about the tool: none
            already = (corrected - q)[:, self._rotary] / self._per_rad
            # The whole way from the programmed pose, so that what fades out near a pole stays faded out.
            whole = tilt[..., None] + by_rad @ already[..., None]
            step[:, self._rotary] = ((_faded_inverse(by_rad) @ whole)[..., 0] - already) * self._per_rad
        if self._linear:
            left = miss + (jacobian[:, :3, self._rotary] @ step[:, self._rotary, None])[..., 0]
            step[:, self._linear] = -(np.linalg.pinv(jacobian[:, :3, self._linear]) @ left[..., None])[..., 0]
        return step

    def _jacobian(self, q: Array) -> Array:
        """Return d(tool)/dq of the erroneous chain to first order, shape (n, 6, A)."""
        jacobian = self._chain.jacobian(q, self._tool_mm)
        by_term = self._chain.sensitivity(q, self._tool_mm) * self._errors.slopes(q)[:, None, :]
        for k, column in self._terms:
            jacobian[:, :, column] += by_term[:, :, k]
        return jacobian

    def _check(self, q: Array, residual: Array) -> None:
        """Raise where the linear axes reach every direction, and yet the tip is not in its place."""
        if not len(q) or residual.max() <= RESIDUAL_MM:
            return
        reached = np.linalg.svd(self._chain.jacobian(q, self._tool_mm)[:, :3, self._linear], compute_uv=False)
        failed = ~(residual <= RESIDUAL_MM) & (len(self._linear) >= 3) & (reached.min(axis=1, initial=1.0) > SPANNED)
        if not failed.any():
            return
        worst = int(np.argmax(np.where(failed, np.nan_to_num(residual, nan=np.inf), -1.0)))
        names = self._chain.machine.axis_names
        at = ", ".join(f"{a} {v:g}" for a, v in zip(names, q[worst], strict=True))
        raise ComputeError(
            f"compensation at {at} must reach 1 nm, got a residual of {residual[worst] * 1e6:.3g} nm; "
            "the error terms change faster with position than the axis moves"
        )


def _faded_inverse(matrix: Array) -> Array:
    """Return the pseudo-inverse (n, r, 3) of (n, 3, r), in which directions that hardly turn the tool axis fade out.

    A singular value s counts as 1 / s down to `SINGULAR`, and below it as s / SINGULAR², which joins there and
    falls to zero: the correction stays bounded by the error over `SINGULAR`, and continuous.
    """
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    gain = np.where(s >= SINGULAR, 1.0 / np.maximum(s, SINGULAR), s / SINGULAR**2)
    inverse: Array = np.swapaxes(vt, -1, -2) @ (gain[..., None] * np.swapaxes(u, -1, -2))
    return inverse
