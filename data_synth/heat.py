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
from model.structure import ROTARY_AXES


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
    """Heat by the feed of one axis [mm/min, degree/min], onto nodes by share."""

    axis: str
    law: Law
    onto: Mapping[str, float]

    def add(self, power_W: Array, programme: Programme, node: Mapping[str, int], condition: Array) -> None:
        """See `Source`."""
        heat = condition * self.law.power(programme.feed_per_min[:, programme.column(self.axis)])
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
        column = programme.column(self.screw.axis)
        heat = condition * self.share * self.law.power(programme.feed_per_min[:, column])
        covered = self.coverage(programme.stroke_low[:, column], programme.stroke_high[:, column])
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
class AccelerationSource:
    """Copper losses of an axis' motor while it speeds up and brakes, onto nodes by share.

    While it does, the motor's current is m a / k and its loss (m a / k)² R. Between the ends of its stroke L the
    axis travels at its rapid feed V and rests in between, so that v is its mean: v / L strokes per second, each
    with two changes of speed that last V / a, or √(L / a) where the stroke is too short to reach V. So the motor
    accelerates for the share 2 (v / L) min(V / a, √(L / a)) of the time, at most all of it.

    Attributes
    ----------
    moved : mass that it accelerates, screw and rotor included [kg]; a rotary axis' inertia [kg m²]
    acceleration : [m/s², rad/s²]
    per_ampere : force or torque per current, k [N/A, N m/A]
    ohm : resistance of the winding, R
    rapid_per_min : V [mm/min, degree/min]
    """

    axis: str
    onto: Mapping[str, float]
    moved: float
    acceleration: float
    per_ampere: float
    ohm: float
    rapid_per_min: float

    def add(self, power_W: Array, programme: Programme, node: Mapping[str, int], condition: Array) -> None:
        """See `Source`."""
        column = programme.column(self.axis)
        stroke = programme.stroke_high[:, column] - programme.stroke_low[:, column]
        heat = condition * self.loss_W() * self.duty(programme.feed_per_min[:, column], stroke)
        for name, share in self.onto.items():
            power_W[:, node[name]] += share * heat

    def loss_W(self) -> float:
        """Return the loss while it accelerates."""
        return (self.moved * self.acceleration / self.per_ampere) ** 2 * self.ohm

    def duty(self, feed_per_min: Array, stroke: Array) -> Array:
        """Return the share of the time in which it accelerates at these mean feeds and lengths of stroke."""
        a = self.acceleration * (180.0 / np.pi if self.axis in ROTARY_AXES else 1e3)  # mm/s², degree/s²
        change_s = np.minimum(self.rapid_per_min / 60.0 / a, np.sqrt(stroke / a))
        share: Array = np.minimum(1.0, 2.0 * feed_per_min / 60.0 / stroke * change_s)
        return share


@dataclass(frozen=True)
class SpindleStartSource:
    """Losses of a spindle motor that runs up from standstill and brakes again, as at each change of tool.

    Both times the rotor's energy J ω² / 2 passes through the motor, which keeps a share of it as heat.
    """

    onto: Mapping[str, float]
    inertia_kg_m2: float
    lost: float

    def add(self, power_W: Array, programme: Programme, node: Mapping[str, int], condition: Array) -> None:
        """See `Source`."""
        omega = programme.speed_rpm * (2.0 * np.pi / 60.0)
        heat = condition * self.lost * self.inertia_kg_m2 * omega**2 * programme.starts / programme.period_s
        for name, share in self.onto.items():
            power_W[:, node[name]] += share * heat


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
