"""What a programme may ask of a machine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from data_synth.network import Array
from model.structure import ROTARY_AXES

Pair = tuple[float, float]


@dataclass(frozen=True)
class Capability:
    """Spindle speed, and by axis the highest mean feed and the stroke; axes in the machine's order.

    Attributes
    ----------
    top_feed_per_min : [mm/min, degree/min]
    strokes : [mm, degree]
    """

    top_rpm: float
    top_feed_per_min: Mapping[str, float]
    strokes: Mapping[str, Pair]

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes, in the order of a programme's columns."""
        return tuple(self.strokes)

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the axes that slide."""
        return tuple(axis for axis in self.axes if axis not in ROTARY_AXES)

    @property
    def rotary(self) -> tuple[str, ...]:
        """Names of the axes that turn."""
        return tuple(axis for axis in self.axes if axis in ROTARY_AXES)

    def columns(self) -> tuple[Array, Array, Array]:
        """Return the top feed and the two ends of the stroke of each axis, shape (A,) each."""
        low, high = np.array([self.strokes[axis] for axis in self.axes]).T
        return np.array([self.top_feed_per_min[axis] for axis in self.axes]), low, high
