"""What leads a body along its guide: a bar, held at one point, that grows with its own temperature."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from data_synth.beam import Vector, along_line
from data_synth.network import Array


class Bar(Protocol):
    """A bar along one coordinate, its nodes at `centres_mm`."""

    @property
    def fixed_mm(self) -> float:
        """Where it is held."""

    @property
    def nodes(self) -> tuple[str, ...]:
        """Its nodes."""

    @property
    def centres_mm(self) -> tuple[float, ...]:
        """Where the nodes are."""

    @property
    def expansion_per_K(self) -> float:
        """Its coefficient of thermal expansion."""


class Drive(Bar, Protocol):
    """A ball screw or a linear scale, in the frame of the body that holds it (the joint's lower body)."""

    @property
    def axis(self) -> str:
        """Name of the axis."""

    @property
    def along(self) -> int:
        """Coordinate that it runs along."""

    @property
    def on(self) -> str:
        """Part of the body that holds it."""

    @property
    def line_mm(self) -> Vector | None:
        """A point of its line."""

    def rider_mm(self, position_mm: Array) -> Array:
        """Return where nut or reading head stand at these axis positions."""

    def rider_shift(self, position_mm: Array, node: Mapping[str, int]) -> Array:
        """Return their shift relative to the fixed point, shape (n, N) [mm per K, or per mm of a bend]."""


def strain(bar: Bar, at_mm: Array, node: Mapping[str, int]) -> Array:
    """Return the integral of α θ from a bar's fixed point to these coordinates, shape (n, N) [mm/K]."""
    _, once, _ = along_line(bar.centres_mm, np.append(at_mm, bar.fixed_mm))
    shift = np.zeros((len(at_mm), len(node)))
    shift[:, [node[name] for name in bar.nodes]] = bar.expansion_per_K * (once[:-1] - once[-1])
    return shift
