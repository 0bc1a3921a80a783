"""Compensation: the coordinates to command so that the tip ends up where the ideal chain puts it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.chain import Chain
from model.error_map import ErrorMap
from model.exceptions import ComputeError
from model.transforms import Array

RESIDUAL_MM = 1e-6
"""What the exact chain's residual may be at most: 1 nm."""
CONVERGED_MM = 1e-9
"""Where Newton stops: a thousandth of that, which one further step usually costs."""
MAX_ITERATIONS = 30
CHUNK = 8192
"""Positions worked on at once, so that memory stays flat: about 30 MB for a machine of 42 terms."""


@dataclass(frozen=True)
class Compensation:
    """Corrected coordinates of n positions.

    Attributes
    ----------
    corrected : shape (n, A), what to command [mm]
    residual_mm : shape (n,), distance of the exact chain's tip from the ideal one after compensation
    outside : shape (n,), whether a corrected coordinate leaves its axis' range
    """

    corrected: Array
    residual_mm: Array
    outside: NDArray[np.bool_]


def compensate(chain: Chain, q: Array, errors: ErrorMap, tool_mm: Array | None = None) -> Compensation:
    """Find axis coordinates for which the erroneous chain puts the tip where the ideal chain puts it at q.

    Newton on the exact chain. The Jacobian is the ideal chain's, plus the sensitivity times the slopes of the
    error terms, since the terms are functions of the corrected coordinates, too.

    Parameters
    ----------
    q : shape (n, A), programmed coordinates [mm]
    errors : the error terms
    tool_mm : tool tip in the tool frame, shape (3,), by default the machine's

    Raises
    ------
    ComputeError
        where the residual does not fall to 1 nm; it names the position.
    """
    parts = [_compensate(chain, q[i : i + CHUNK], errors, tool_mm) for i in range(0, len(q), CHUNK)]
    corrected = np.concatenate([p for p, _ in parts]) if parts else np.empty_like(q)
    residual = np.concatenate([r for _, r in parts]) if parts else np.empty(0)
    if len(q) and not residual.max() <= RESIDUAL_MM:
        worst = int(np.nanargmax(np.where(np.isfinite(residual), residual, np.inf)))
        at = ", ".join(f"{a} {v:g}" for a, v in zip(chain.machine.axis_names, q[worst], strict=True))
        raise ComputeError(
            f"compensation at {at} must reach 1 nm, got a residual of {residual[worst] * 1e6:.3g} nm; "
            "the error terms change faster with position than the axis moves"
        )
    low = np.array([chain.machine.axes[a].low for a in chain.machine.axis_names])
    high = np.array([chain.machine.axes[a].high for a in chain.machine.axis_names])
    outside = np.logical_or(corrected < low, corrected > high)
    return Compensation(corrected, residual, np.logical_or.reduce(outside, axis=1))


def _compensate(chain: Chain, q: Array, errors: ErrorMap, tool_mm: Array | None) -> tuple[Array, Array]:
    wanted = chain.tip(q, None, tool_mm)
    corrected = q.copy()
    for _ in range(MAX_ITERATIONS):
        miss = chain.tip(corrected, errors.evaluate(corrected), tool_mm) - wanted
        residual: Array = np.linalg.norm(miss, axis=1)
        if residual.max(initial=0.0) <= CONVERGED_MM:
            break
        corrected = corrected - np.linalg.solve(_jacobian(chain, corrected, errors, tool_mm), miss[..., None])[..., 0]
    return corrected, residual


def _jacobian(chain: Chain, q: Array, errors: ErrorMap, tool_mm: Array | None) -> Array:
    """Return d(tip)/dq of the erroneous chain to first order, shape (n, 3, A)."""
    jacobian = chain.tip_jacobian(q)
    by_term = chain.sensitivity(q, tool_mm)[:, :3, :] * errors.slopes(q)[:, None, :]
    for k, term in enumerate(chain.machine.terms):
        if term.kind == "motion":
            jacobian[:, :, chain.machine.axis_names.index(term.axis)] += by_term[:, :, k]
    return jacobian
