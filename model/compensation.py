"""Compensation: the coordinates to command so that the tool ends up where the ideal chain puts it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.chain import Chain
from model.error_map import ErrorMap
from model.exceptions import ComputeError, DataError, MachineError
from model.kernel import SINGULAR
from model.kernel_plan import plan
from model.transforms import Array
from model.validation import did_you_mean

__all__ = ["RESIDUAL_MM", "SINGULAR", "Compensation", "Compensator", "compensate"]

RESIDUAL_MM = 1e-6
"""What the exact chain's residual may be at most: 1 nm."""
SPANNED = 0.1
"""Least share of each direction that the linear axes must reach for the position to be fully theirs."""
RUNAWAY_MM = 1e6
"""A residual beyond a kilometre is no direction that is out of reach but an iteration that ran away."""
CHECKED = 1000
"""Late positions whose reach is looked at together."""
SHARE = 16384
"""Positions that a thread takes at a time: enough to outweigh its start, few enough that cores finish together."""


@dataclass(frozen=True)
class Compensation:
    """Corrected coordinates of n positions.

    Attributes
    ----------
    corrected : shape (n, A), what to command [mm, degree]
    residual_mm : shape (n,), distance of the exact chain's tip from the ideal one after compensation
    tilt_rad : shape (n,), angle of the tool axis from the ideal one after compensation: what the machine has no
        rotary axis to remove, or too little of one near a singular pose
    deviation_mm : shape (n, 3), where the exact chain puts the tip at the programmed coordinates, less where the ideal
        one does
    low, high : shape (A,), the ends of the axes' ranges
    """

    corrected: Array
    residual_mm: Array
    tilt_rad: Array
    deviation_mm: Array
    low: Array
    high: Array

    @property
    def outside(self) -> NDArray[np.bool_]:
        """Whether a corrected coordinate leaves its axis' range, shape (n,)."""
        return np.asarray(np.logical_or.reduce((self.corrected < self.low) | (self.corrected > self.high), axis=1))


class Compensator:
    """A chain, an error map and a tool, made ready to compensate any number of positions.

    Iterates on the exact chain, position first: rotary axes turn the tool axis back as far as they can, linear axes
    then put the tip in its place. What an axis does is the ideal chain's; error terms are looked up at the corrected
    coordinates.

    Parameters
    ----------
    tool_mm : tool tip in the tool frame, shape (3,), by default the machine's
    keep : axes that must stay as programmed

    Raises
    ------
    MachineError
        where `keep` names an axis that the machine does not have.
    DataError
        where an error term is not a number of a machine's size, or the tool is not three finite numbers.
    """

    def __init__(self, chain: Chain, errors: ErrorMap, tool_mm: Array | None = None, keep: Sequence[str] = ()) -> None:
        names = chain.machine.axis_names
        for name in keep:
            if name not in names:
                raise MachineError(f"unknown axis '{name}' to keep" + did_you_mean(name, list(names)))
        self._chain, self._tool_mm = chain, tool_mm
        self._plan = plan(chain, errors, tool_mm, keep)
        axes = [chain.machine.axes[a] for a in names]
        self._low, self._high = np.array([a.low for a in axes]), np.array([a.high for a in axes])

    def carrying(self, errors: ErrorMap) -> Compensator:
        """Return one of the same chain, tool and kept axes with other errors, in less time than a new one takes.

        Raises
        ------
        DataError
            where an error term is not a number of a machine's size.
        """
        other = copy(self)
        other._plan = self._plan.carrying(self._chain, errors)
        return other

    def compensate(self, q: Array, threads: int | None = None) -> Compensation:
        """Find axis coordinates for which the erroneous chain puts the tool where the ideal chain puts it at q.

        Parameters
        ----------
        q : shape (n, A), programmed coordinates [mm, degree]
        threads : how many to use, by default one a core, and one alone where there is little to do

        Raises
        ------
        ComputeError
            where the axes reach every direction and the residual does not fall to 1 nm, or where the iteration runs
            away; it names the position.
        DataError
            where there is not one column an axis, or a coordinate is not finite.
        """
        q = np.ascontiguousarray(q, dtype=np.float64)
        if not q.flags.behaved:  # such as what was received, which cannot be written to
            q = q.copy()
        names = self._chain.machine.axis_names
        if q.ndim != 2 or q.shape[1] != len(names):
            raise DataError(
                f"coordinates must have shape (n, {len(names)}), one column for each of {', '.join(names)}, "
                f"got {q.shape}"
            )
        n, axes = q.shape
        results = np.empty(n * (axes + 5))
        ends = n * axes, n * (axes + 1), n * (axes + 2)
        residual = results[ends[0] : ends[1]]
        if n <= SHARE:
            self._solve(q, 0, n, results)
        else:
            self._solve_in_shares(q, results, threads or os.cpu_count() or 1)
        self._check(q, residual)
        corrected, deviation = results[: ends[0]].reshape(n, axes), results[ends[2] :].reshape(n, 3)
        return Compensation(corrected, residual, results[ends[1] : ends[2]], deviation, self._low, self._high)

    def _solve_in_shares(self, q: Array, results: Array, threads: int) -> None:
        starts = range(0, len(q), SHARE)

        def work(start: int) -> None:
            self._solve(q, start, min(start + SHARE, len(q)), results)

        workers = min(threads, len(starts))
        if workers > 1:
            with ThreadPoolExecutor(workers) as pool:
                list(pool.map(work, starts))
        else:
            for start in starts:
                work(start)

    def _solve(self, q: Array, start: int, stop: int, results: Array) -> None:
        if not np.logical_and.reduce(np.isfinite(q[start:stop]), axis=None):
            row = start + int(np.argmin(np.isfinite(q[start:stop]).all(axis=1)))
            raise DataError(f"coordinates must be finite numbers, got others in row {row + 1}")
        if stop > start:
            self._plan.solve(q, start, stop, results)

    def _check(self, q: Array, residual: Array) -> None:
        """Raise where the linear axes reach every direction, and yet the tip is not in its place."""
        if not len(q) or np.maximum.reduce(residual) <= RESIDUAL_MM:  # nearly always; never with NaN
            return
        failed = np.flatnonzero(~(residual <= RUNAWAY_MM))
        late = np.flatnonzero(~(residual <= RESIDUAL_MM))
        linear = self._plan.linear_axes
        for first in range(0, len(late) if len(linear) >= 3 else 0, CHECKED):
            if len(failed):
                break
            part = late[first : first + CHECKED]
            jacobian = self._chain.jacobian(q[part], self._tool_mm)[:, :3, linear]
            failed = part[np.linalg.svd(jacobian, compute_uv=False).min(axis=1) > SPANNED]
        if not len(failed):
            return
        names = self._chain.machine.axis_names
        at = ", ".join(f"{a} {v:g}" for a, v in zip(names, q[failed[0]], strict=True))
        raise ComputeError(
            f"compensation at {at} must reach 1 nm, got a residual of {residual[failed[0]] * 1e6:.3g} nm; "
            "the error terms change with position about as fast as the axis moves, or faster"
        )


def compensate(
    chain: Chain, q: Array, errors: ErrorMap, tool_mm: Array | None = None, keep: Sequence[str] = ()
) -> Compensation:
    """Compensate once; see `Compensator` and its `compensate` for parameters and errors."""
    return Compensator(chain, errors, tool_mm, keep).compensate(q)
