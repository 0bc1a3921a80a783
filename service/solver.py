"""Corrections of positions from one error map: what is computed once the map and the tool are known.

A solver looks at nothing that changes, so a thread may work with it while the loop goes on.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.chain import Chain
from model.compensation import Compensator
from model.error_map import ErrorMap
from model.exceptions import ComputeError, DataError
from model.machine import Limits
from model.transforms import Array
from service.safety import FEW, clip

MOST_KEPT = 256
"""Error maps made ready, of all machines together, each of some 0.2 MB. Making one ready takes a millisecond, so that a
thousand machines that are asked in turns need no more."""

Deviations = Callable[[Array], Array]


@dataclass(frozen=True)
class Solved:
    """Corrections of n positions.

    Attributes
    ----------
    corrected, correction_mm : shape (n, A) [mm]
    deviation_mm : shape (n, 3), predicted at the programmed positions, not limited
    clipped : shape (n,), whether the absolute limit holds it back
    """

    corrected: Array
    correction_mm: Array
    deviation_mm: Array
    clipped: NDArray[np.bool_]


@dataclass(frozen=True)
class Solver:
    """The error map that is served, the one that is predicted, and the absolute limit.

    Attributes
    ----------
    served : compensates with the error map that is served
    predicted : deviations [mm] of the one that is predicted; None where the two are one
    """

    served: Compensator
    predicted: Deviations | None
    limits: Limits

    def solve(self, q: Array, threads: int | None = 1) -> Solved:
        """Return the corrections of positions of shape (n, A) [mm].

        Parameters
        ----------
        threads : how many to use, None is one a core

        Raises
        ------
        ComputeError
            where the compensation does not converge, or a result is not a number.
        """
        found = self.served.compensate(q, threads)
        correction, clipped = clip(found.corrected - q, self.limits)
        deviation = found.deviation_mm if self.predicted is None else self.predicted(q)
        if not (_finite(correction) and _finite(deviation)):
            raise ComputeError("corrections must be finite numbers, got others; nothing was served")
        return Solved(q + correction, correction, deviation, clipped)


def _finite(values: Array) -> bool:
    if len(values) <= FEW:
        return all(math.isfinite(value) for row in values.tolist() for value in row)
    # The largest is not a number where one is not.
    return float(np.maximum.reduce(np.abs(values), axis=None, initial=0.0)) < np.inf


_kept: OrderedDict[tuple[Solvers, float | None, tuple[str, ...]], tuple[ErrorMap, Compensator]] = OrderedDict()


class Solvers:
    """Makes solvers; what they need of the newest error maps and tools is kept from one request to the next."""

    def __init__(self, chain: Chain) -> None:
        self._chain = chain
        self._limits = chain.machine.limits

    def of(self, served: ErrorMap, predicted: ErrorMap, tool_length_mm: float | None) -> Solver:
        """Return the solver of these error maps and this tool; None is the machine's own."""
        compensator = self._compensator(served, tool_length_mm, ())
        return Solver(
            compensator, None if predicted is served else self._deviations(predicted, tool_length_mm), self._limits
        )

    def tool_mm(self, tool_length_mm: float | None) -> Array | None:
        """Return the tool tip in the tool frame, shape (3,); None is the machine's own."""
        return None if tool_length_mm is None else tool_length_mm * np.asarray(self._chain.machine.tool.direction)

    def _deviations(self, errors: ErrorMap, tool_length_mm: float | None) -> Deviations:
        try:
            compensator = self._compensator(errors, tool_length_mm, self._chain.machine.axis_names)
        except DataError:  # angles beyond those of the compiled path, which nobody is corrected by
            chain, tool_mm = self._chain, self.tool_mm(tool_length_mm)
            return lambda q: chain.tip(q, errors.evaluate(q), tool_mm) - chain.tip(q, None, tool_mm)
        return lambda q: compensator.compensate(q, 1).deviation_mm

    def _compensator(self, errors: ErrorMap, tool_length_mm: float | None, keep: tuple[str, ...]) -> Compensator:
        key = self, tool_length_mm, keep
        known, compensator = _kept.get(key, (None, None))
        if compensator is None:
            compensator = Compensator(self._chain, errors, self.tool_mm(tool_length_mm), keep)
        elif known is not errors:
            compensator = compensator.carrying(errors)
        _kept[key] = errors, compensator
        _kept.move_to_end(key)
        if len(_kept) > MOST_KEPT:
            _kept.popitem(last=False)
        return compensator
