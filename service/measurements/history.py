"""What was predicted in the last hours, so that a probed deviation meets the prediction of its own moment."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.thermal import Thermal, Zero

KEPT_S = 2 * 3600.0
"""How long predictions are kept [s]: a gateway posts a probing when it is done. 120 of them take 60 kB a machine."""
EVERY_S = 60.0
"""Telemetry may come more often; structures do not move in less."""
ARRIVED_UM = 0.5
"""What was served counts as the prediction where it was no further from it [µm]."""


@dataclass(frozen=True)
class Past:
    """A prediction.

    Attributes
    ----------
    time_s : of the sample it was made of
    coefficients : of the thermal part, absolute [µm, µrad], shape (P,); in single precision, some 0.0001 µm
    spread : see `Thermal.spread`, but of the state alone; None where the bundle does not say
    zero : the datum then
    weight : how much of the thermal part was served; None where something else than it was, or nothing
    """

    time_s: float
    coefficients: NDArray[np.float32]
    spread: float | None
    zero: Zero
    weight: float | None

    @classmethod
    def of(cls, thermal: Thermal, weight: float | None) -> Past:
        """Return the present prediction of a network that has a state."""
        state = thermal.state
        assert state is not None
        coefficients = state.coefficients.astype(np.float32)
        return cls(state.time_s, coefficients, thermal.spread_now(), thermal.zero, weight)


class History:
    """The predictions of the last `KEPT_S`, one in `EVERY_S`."""

    def __init__(self) -> None:
        self._kept: deque[Past] = deque()

    def is_due(self, time_s: float) -> bool:
        """Return whether a prediction of that time is to be noted."""
        return not self._kept or time_s - self._kept[-1].time_s >= EVERY_S

    def note(self, past: Past) -> None:
        """Remember a prediction, newer than all others."""
        self._kept.append(past)
        while past.time_s - self._kept[0].time_s > KEPT_S:
            self._kept.popleft()

    @property
    def from_s(self) -> float | None:
        """Time from which predictions are known; None without any."""
        return self._kept[0].time_s if self._kept else None

    def at(self, time_s: float, newest: Past) -> Past | None:
        """Return the prediction of a moment, linear between two, and the newest from there on.

        None before the first. The datum is that of the earlier one; what was served is known where both agree.
        """
        kept = [p for p in self._kept if p.time_s < newest.time_s] + [newest]
        right = bisect_right(kept, time_s, key=lambda p: p.time_s)
        if right == 0:
            return None
        before = kept[right - 1]
        if right == len(kept):
            return before
        after = kept[right]
        share = (time_s - before.time_s) / (after.time_s - before.time_s)
        mixed = (before.coefficients * (1.0 - share) + after.coefficients * share).astype(np.float32)
        known = before.weight is not None and before.weight == after.weight and before.zero is after.zero
        spread = None if before.spread is None or after.spread is None else max(before.spread, after.spread)
        return Past(time_s, mixed, spread, before.zero, before.weight if known else None)
