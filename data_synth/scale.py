"""A linear scale: the axis stands where the scale's marks have moved to.

The scale is held at one point and grows freely from there, by its own expansion and its own temperature; the control
moves the axis until the reading head sees the mark it wants. Steel tape or glass (Heidenhain, Linear Encoders for
Numerically Controlled Machine Tools: steel tape about 10e-6, glass about 8e-6, Zerodur 0 per K).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from data_synth.beam import Vector
from data_synth.drive import strain
from data_synth.network import Array

STEEL_TAPE_PER_K = 10e-6
GLASS_PER_K = 8e-6


@dataclass(frozen=True)
class Scale:
    """One scale along coordinate `along` (0, 1, 2), in the frame of the body that holds it.

    Attributes
    ----------
    axis : name of the axis that it measures
    reader_at_zero_mm, reader_sign : the reading head stands at reader_at_zero + sign * p when the axis is at p
    fixed_mm : where the scale is held
    nodes, edges_mm : its nodes and the ends of the pieces they stand for, rising
    on : part of that body that holds it; "" is where the carriage runs
    line_mm : a point of its line in that body's frame (its coordinate `along` does not matter); None is the
        carriages' own line, so that no tilt of the body is taken for travel (Abbe)
    """

    axis: str
    along: int
    reader_at_zero_mm: float
    reader_sign: int
    fixed_mm: float
    nodes: tuple[str, ...]
    edges_mm: tuple[float, ...]
    expansion_per_K: float
    on: str = ""
    line_mm: Vector | None = None

    @property
    def centres_mm(self) -> tuple[float, ...]:
        """Where the nodes are."""
        return tuple((a + b) / 2 for a, b in zip(self.edges_mm[:-1], self.edges_mm[1:], strict=True))

    def rider_mm(self, position_mm: Array) -> Array:
        """Return where the reading head stands at these axis positions."""
        return self.reader_at_zero_mm + self.reader_sign * position_mm

    def rider_shift(self, position_mm: Array, node: Mapping[str, int]) -> Array:
        """Return the shift of the marks under the head relative to the fixed point, shape (n, N) [mm/K]."""
        return strain(self, self.rider_mm(position_mm), node)
