"""What sets the angle of a rotary axis: an encoder's disc, or a worm wheel.

Both turn with the body. Where the body's uneven warmth or its bearings' run-out pushes the disc off the axis line,
what is read at the standing head (or meshes with the standing worm) is wrong once per turn: by the shift along the
tangent over the radius.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import radians, tan

import numpy as np

from data_synth.beam import Vector
from data_synth.displacement import Displacement
from data_synth.elastic import Elastic
from data_synth.materials import STEEL
from data_synth.network import Array

PRESSURE_ANGLE = radians(20.0)  # of worm gears, DIN 3975


@dataclass(frozen=True)
class Encoder:
    """A direct encoder with one reading head.

    Attributes
    ----------
    disc_mm : centre of the disc on the axis line, in the turning body's frame
    radius_mm : of its marks
    tangent : direction in which the marks pass the head, unit vector in the lower body's frame
    of : part of the turning body that carries the disc; "" is its first
    """

    disc_mm: Vector
    radius_mm: float
    tangent: Vector
    of: str = ""

    def turn(self, own: Elastic, rotation: Array, node: Mapping[str, int], runs: Displacement) -> Array:
        """Return the body's turn about its line at these rotations lower_R_body (n, 3, 3), shape (n, N) [rad/K].

        The control turns the body until the head sees the mark it wants: back by what the disc was pushed on, by the
        body's own deformation and by what its bearings displace it, `runs` in the lower body's axes.
        """
        at_disc = runs.carried(rotation @ np.array(self.disc_mm))
        pushed = (own.displacement(self.disc_mm, self.of).seen(rotation) + at_disc).shift  # (n, 3, N)
        turn: Array = -np.tensordot(pushed, np.array(self.tangent), (1, 0)) / self.radius_mm
        return turn


@dataclass(frozen=True)
class Worm:
    """A worm and its wheel, which is the disc; the worm stands in the lower body at `centre_mm` from the axis line.

    Attributes
    ----------
    wheel, housing : nodes with shares that sum to 1; a wheel warmer than the housing grows into the worm, which by
        its flanks pushes it round by growth times the tangent of the pressure angle
    """

    disc_mm: Vector
    radius_mm: float
    tangent: Vector
    of: str = ""
    wheel: Mapping[str, float] = field(default_factory=dict)
    housing: Mapping[str, float] = field(default_factory=dict)
    centre_mm: float = 0.0

    def turn(self, own: Elastic, rotation: Array, node: Mapping[str, int], runs: Displacement) -> Array:
        """See `Encoder.turn`."""
        turn = Encoder(self.disc_mm, self.radius_mm, self.tangent, self.of).turn(own, rotation, node, runs)
        per_K = STEEL.expansion_per_K * self.centre_mm * tan(PRESSURE_ANGLE) / self.radius_mm
        for shares, sign in ((self.wheel, 1.0), (self.housing, -1.0)):
            for name, share in shares.items():
                turn[:, node[name]] += sign * share * per_K
        return turn


Angle = Encoder | Worm
