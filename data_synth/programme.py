"""What a machine is told to do: one row per interval, held over it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_synth.network import Array, OperatingPoint

SPEED_LEVELS = 8  # steps of the tabulated convection law over the speed range; heat uses the true speed (chosen)
MOVING_MM_PER_MIN = 300.0  # mean feed above which a screw counts as turning (chosen)


@dataclass(frozen=True)
class Programme:
    """A duty cycle of n intervals.

    Attributes
    ----------
    kind : name of the duty cycle
    speed_rpm : spindle speed, shape (n,)
    feed_mm_per_min : mean path speed of X, Y, Z without sign, shape (n, 3)
    stroke_low_mm, stroke_high_mm : between which X, Y, Z move, shape (n, 3); no telemetry tells
    coolant, door : shape (n,)
    load : cutting load, which multiplies spindle heat by 1 + load, shape (n,); no telemetry tells
    """

    kind: str
    period_s: float
    speed_rpm: Array
    feed_mm_per_min: Array
    stroke_low_mm: Array
    stroke_high_mm: Array
    coolant: NDArray[np.bool_]
    door: NDArray[np.bool_]
    load: Array

    def __len__(self) -> int:
        return len(self.speed_rpm)

    def operating_points(self, top_rpm: float) -> tuple[list[OperatingPoint], NDArray[np.intp]]:
        """Return the operating points that occur and the index of each interval's, shape (n,)."""
        level = np.rint(self.speed_rpm / top_rpm * SPEED_LEVELS).astype(np.intp)
        moving = (self.feed_mm_per_min > MOVING_MM_PER_MIN).any(axis=1)
        code = ((level * 2 + self.coolant) * 2 + self.door) * 2 + moving
        codes, which = np.unique(code, return_inverse=True)
        points = [OperatingPoint(int(c) // 8 / SPEED_LEVELS, bool(c & 4), bool(c & 2), bool(c & 1)) for c in codes]
        return points, which

    def after(self, earlier: Programme) -> Programme:
        """Return both, one after the other, under this one's name."""
        return Programme(
            self.kind,
            self.period_s,
            *(
                np.concatenate([getattr(earlier, name), getattr(self, name)])
                for name in (
                    "speed_rpm",
                    "feed_mm_per_min",
                    "stroke_low_mm",
                    "stroke_high_mm",
                    "coolant",
                    "door",
                    "load",
                )
            ),
        )
