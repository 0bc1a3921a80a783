"""Where heat comes from: friction of bearings, nuts and guides, losses of motors, standing loads.

A source knows its law and the nodes it warms; `add` puts its power [W] into the rows of a programme, times a
factor for what no telemetry tells: grease, preload, wear.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from data_synth.network import Array
from data_synth.programme import Programme
from data_synth.screw import Screw


class Source(Protocol):
    """Anything that warms nodes."""

    def add(self, power_W: Array, programme: Programme, node: Mapping[str, int], condition: Array) -> None:
        """Add this source's heat, times its condition (n,), to `power_W`, shape (n, N)."""


class Law(Protocol):
    """Heat as a function of speed."""

    def power(self, speed: Array) -> Array:
        """Return the heat [W] at these speeds."""


@dataclass(frozen=True)
class BearingFriction:
    """Rolling bearings: Palmgren's friction torque, as in Harris and Kotzalas, Rolling Bearing Analysis (2006).

    M = 1e-7 f0 (ν n)^(2/3) d³ + M1 [N mm] and H = 1.047e-4 n M [W], with n in rpm, ν in mm²/s, d in mm: heat grows
    as speed to the power 5/3.
    """

    number: int
    mean_diameter_mm: float
    lubrication: float
    viscosity_mm2_per_s: float
    load_torque_N_mm: float

    def power(self, speed: Array) -> Array:
        """Return the friction heat of all bearings of the set [W] at these speeds [rpm]."""
        viscous = 1e-7 * self.lubrication * (self.viscosity_mm2_per_s * speed) ** (2 / 3) * self.mean_diameter_mm**3
        heat: Array = self.number * 1.047e-4 * speed * (viscous + self.load_torque_N_mm)
        return heat


@dataclass(frozen=True)
class PowerLaw:
    """Heat that grows as a power of speed from a known point."""

    W: float
    at_speed: float
    exponent: float

    def power(self, speed: Array) -> Array:
        """Return W (speed / at_speed)^exponent."""
        heat: Array = self.W * (speed / self.at_speed) ** self.exponent
        return heat


@dataclass(frozen=True)
class SpindleSource:
    """Heat by spindle speed, onto nodes by share; cutting multiplies it by 1 + sensitivity * load."""

    law: Law
    onto: Mapping[str, float]
    load_sensitivity: float = 0.0

    def add(self, power_W: Array, programme: Programme, node: Mapping[str, int], condition: Array) -> None:
        """See `Source`."""
        heat = condition * self.law.power(programme.speed_rpm) * (1.0 + self.load_sensitivity * programme.load)
        for name, share in self.onto.items():
            power_W[:, node[name]] += share * heat


@dataclass(frozen=True)
class FeedSource:
    """Heat by the feed of one axis (0, 1, 2 for X, Y, Z), onto nodes by share."""

    axis: int
    law: Law
    onto: Mapping[str, float]

    def add(self, power_W: Array, programme: Programme, node: Mapping[str, int], condition: Array) -> None:
        """See `Source`."""
        heat = condition * self.law.power(programme.feed_mm_per_min[:, self.axis])
        for name, share in self.onto.items():
            power_W[:, node[name]] += share * heat


@dataclass(frozen=True)
class StrokeSource:
    """The screw's share of nut friction: it falls where the nut runs.

    Attributes
    ----------
    share : of the nut's friction, the part that enters the screw
    """

    screw: Screw
    law: Law
    share: float

    def add(self, power_W: Array, programme: Programme, node: Mapping[str, int], condition: Array) -> None:
        """See `Source`."""
        axis = self.screw.axis
        heat = condition * self.share * self.law.power(programme.feed_mm_per_min[:, axis])
        covered = self.coverage(programme.stroke_low_mm[:, axis], programme.stroke_high_mm[:, axis])
        for k, name in enumerate(self.screw.nodes):
            power_W[:, node[name]] += heat * covered[:, k]

    def coverage(self, low_mm: Array, high_mm: Array) -> Array:
        """Return the share of the stroke that runs over each piece, shape (n, pieces); rows sum to 1."""
        edges = np.array(self.screw.edges_mm)
        ends = np.sort(self.screw.nut_mm(np.column_stack([low_mm, high_mm])), axis=1)
        inside = np.minimum(ends[:, 1:], edges[1:]) - np.maximum(ends[:, :1], edges[:-1])
        shares: Array = np.clip(inside, 0.0, None) / (ends[:, 1:] - ends[:, :1])
        return shares


@dataclass(frozen=True)
class StandingSource:
    """Heat that does not depend on speed: while switched on, and with coolant, and with the cutting load."""

    onto: Mapping[str, float]
    always_W: float = 0.0
    coolant_W: float = 0.0
    load_W: float = 0.0

    def add(self, power_W: Array, programme: Programme, node: Mapping[str, int], condition: Array) -> None:
        """See `Source`."""
        heat = condition * (self.always_W + self.coolant_W * programme.coolant + self.load_W * programme.load)
        for name, share in self.onto.items():
            power_W[:, node[name]] += share * heat
