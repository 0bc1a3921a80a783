"""A ball screw as a rotary encoder sees it: the nut stands where the heated screw puts it.

The screw is held in axial direction by its fixed bearing. Seen from there the nut moves by the integral of strain
α θ over the piece between. A screw that is held at its far end too, and stretched on assembly, first gives up that
stretch; only then does it grow freely. Makers advise a stretch for a rise of about 3 K, below 5 K
(gyballscrew.com, "The influence of ball screw pretension").
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from data_synth.beam import Vector
from data_synth.drive import strain
from data_synth.network import Array


@dataclass(frozen=True)
class Screw:
    """One screw along coordinate `along` (0, 1, 2), in the frame of the body that holds it.

    Attributes
    ----------
    axis : name of the axis that it drives
    nut_at_zero_mm, nut_sign : the nut stands at nut_at_zero + sign * p when the axis is at p
    fixed_mm, far_mm : coordinates of the fixed and of the far bearing
    nodes, edges_mm : its nodes and the ends of the pieces they stand for, rising
    held : share of its expansion that two stiff bearings take up while it is stretched
    stretch_K : rise that uses up the stretch; 0 for a screw that is free at its far end
    on : part of that body that holds the bearings; "" is where the carriage runs
    line_mm : a point of its line in that body's frame (its coordinate `along` does not matter); None is the
        carriages' own line, so that no tilt of the body is taken for travel
    """

    axis: str
    along: int
    nut_at_zero_mm: float
    nut_sign: int
    fixed_mm: float
    far_mm: float
    nodes: tuple[str, ...]
    edges_mm: tuple[float, ...]
    expansion_per_K: float
    held: float = 0.0
    stretch_K: float = 0.0
    on: str = ""
    line_mm: Vector | None = None

    @property
    def centres_mm(self) -> tuple[float, ...]:
        """Where the nodes are."""
        return tuple((a + b) / 2 for a, b in zip(self.edges_mm[:-1], self.edges_mm[1:], strict=True))

    def nut_mm(self, position_mm: Array) -> Array:
        """Return where the nut stands at these axis positions."""
        return self.nut_at_zero_mm + self.nut_sign * position_mm

    def nut_shift(self, nut_mm: Array, node: Mapping[str, int]) -> Array:
        """Return the shift of a nut at these coordinates relative to the fixed bearing, shape (n, N) [mm/K].

        Where `node` has a column for this screw's relief, it holds the shift per mm of that.
        """
        shift = strain(self, nut_mm, node)
        if self.relief_name in node:
            shift[:, node[self.relief_name]] = self.push(nut_mm)
        return shift

    @property
    def relief_name(self) -> str:
        """The name of its relief among the causes of displacement."""
        return f"relief of {self.nodes[0]}"

    def rider_mm(self, position_mm: Array) -> Array:
        """See `Drive`."""
        return self.nut_mm(position_mm)

    def rider_shift(self, position_mm: Array, node: Mapping[str, int]) -> Array:
        """See `Drive`."""
        return self.nut_shift(self.nut_mm(position_mm), node)

    def growth(self, node: Mapping[str, int]) -> Array:
        """Return the growth from bearing to bearing, shape (N,) [mm/K]."""
        growth: Array = np.sign(self.far_mm - self.fixed_mm) * self.nut_shift(np.array([self.far_mm]), node)[0]
        return growth

    def push(self, nut_mm: Array) -> Array:
        """Return the shift of a nut per mm that the far bearing pushes the screw back."""
        push: Array = (self.fixed_mm - nut_mm) / abs(self.fixed_mm - self.far_mm)
        return push

    def relief(self, growth_mm: Array) -> Array:
        """Return by how much the far bearing pushes the screw back when it would grow by this [mm].

        A share of the growth until the stretch is used up, with a smooth bend there; zero at zero.
        """
        if not self.stretch_K:
            return np.zeros_like(growth_mm)
        stretch = self.expansion_per_K * self.stretch_K * abs(self.far_mm - self.fixed_mm)
        bend = stretch / 4.0  # chosen: nothing in a machine has a corner

        def softplus(x: Array) -> Array:
            return np.logaddexp(0.0, x)

        left = softplus((stretch - growth_mm) / bend) - softplus(np.full_like(growth_mm, stretch / bend))
        pushed: Array = -self.held * bend * left
        return pushed
