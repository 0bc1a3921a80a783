"""What a machine is told to do: one row per interval, held over it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_synth.network import Array, OperatingPoint

SPEED_LEVELS = 8  # steps of the tabulated convection law over the speed range; heat uses the true speed (chosen)
MOVING_PER_MIN = 300.0  # mean feed [mm/min, degree/min] above which an axis counts as moving (chosen)

ROWS = ("speed_rpm", "starts", "feed_per_min", "stroke_low", "stroke_high", "coolant", "door", "load")
"""What a programme has one row of for each interval."""


@dataclass(frozen=True)
class Programme:
    """A duty cycle of n intervals of a machine with A axes.

    Attributes
    ----------
    kind : name of the duty cycle
    axes : names of the axes, in the order of the columns
    speed_rpm : spindle speed, shape (n,)
    starts : how often the spindle runs up from standstill to that speed in the interval, shape (n,)
    feed_per_min : mean path speed of each axis without sign, shape (n, A) [mm/min, degree/min]
    stroke_low, stroke_high : between which each axis moves, shape (n, A) [mm, degree]; no telemetry tells
    coolant, door : shape (n,)
    load : cutting load, which multiplies spindle heat by 1 + load, shape (n,); no telemetry tells
    """

    kind: str
    period_s: float
    axes: tuple[str, ...]
    speed_rpm: Array
    starts: Array
    feed_per_min: Array
    stroke_low: Array
    stroke_high: Array
    coolant: NDArray[np.bool_]
    door: NDArray[np.bool_]
    load: Array

    def __len__(self) -> int:
        return len(self.speed_rpm)

    def column(self, axis: str) -> int:
        """Return the column of an axis."""
        return self.axes.index(axis)

    def operating_points(self, top_rpm: float) -> tuple[list[OperatingPoint], NDArray[np.intp]]:
        """Return the operating points that occur and the index of each interval's, shape (n,)."""
        level = np.rint(self.speed_rpm / top_rpm * SPEED_LEVELS).astype(np.intp)
        moving = (self.feed_per_min > MOVING_PER_MIN).any(axis=1)
        code = ((level * 2 + self.coolant) * 2 + self.door) * 2 + moving
        codes, which = np.unique(code, return_inverse=True)
        points = [OperatingPoint(int(c) // 8 / SPEED_LEVELS, bool(c & 4), bool(c & 2), bool(c & 1)) for c in codes]
        return points, which

    def after(self, earlier: Programme) -> Programme:
        """Return both, one after the other, under this one's name."""
        both: dict[str, Any] = {n: np.concatenate([getattr(earlier, n), getattr(self, n)]) for n in ROWS}
        return replace(self, **both)

    def part(self, rows: slice) -> Programme:
        """Return these intervals."""
        some: dict[str, Any] = {name: getattr(self, name)[rows] for name in ROWS}
        return replace(self, **some)
