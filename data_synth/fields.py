"""Error terms of a machine as functions of its nodes' temperatures: a linear map and a few bends.

A structure (see `assembly`) builds them; `Fields` evaluates them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from data_synth.network import Array
from data_synth.screw import Screw
from model.machine import Machine

TO_UM_URAD = np.array([1e3, 1e3, 1e3, 1e6, 1e6, 1e6])
"""From mm and rad to µm and µrad, for the six directions of a body's terms."""

SPEED = "speed shift"
"""Name of the spindle's speed shift among the causes of displacement."""


class Bend(Protocol):
    """A cause of displacement that is not proportional to temperature."""

    @property
    def name(self) -> str:
        """Its column in the maps of displacements, behind the nodes."""

    def amount(self, rise_K: Array, speed_rpm: Array) -> Array:
        """Return how much of it there is at these temperature rises (t, N) and speeds (t,), shape (t,) [mm]."""


@dataclass(frozen=True)
class Relief:
    """A stretched screw that pushes back its far bearing; `growth`: beyond what holds it, shape (N,) [mm/K]."""

    screw: Screw
    growth: Array

    @property
    def name(self) -> str:
        """See `Bend`."""
        return self.screw.relief_name

    def amount(self, rise_K: Array, speed_rpm: Array) -> Array:
        """See `Bend`."""
        return self.screw.relief(rise_K @ self.growth)


@dataclass(frozen=True)
class SpeedShift:
    """Axial shift of a spindle's nose with speed, not heat: ball bearings under centrifugal load (grows as n²).

    `um` out of the head is that at `at_rpm`; some micrometres, chosen.
    """

    um: float
    at_rpm: float

    @property
    def name(self) -> str:
        """See `Bend`."""
        return SPEED

    def amount(self, rise_K: Array, speed_rpm: Array) -> Array:
        """See `Bend`."""
        shift: Array = 1e-3 * self.um * (speed_rpm / self.at_rpm) ** 2
        return shift


@dataclass(frozen=True)
class Fields:
    """All error terms.

    Attributes
    ----------
    positions : of each axis, shape (n,) [mm, degree]
    motion : of each axis, shape (6, n, N), mm and rad per K
    location : of each axis, and of "T" and "W" where the machine has their terms, shape (6, N)
    bends : what else moves the machine, and how: shapes (6, n, bends) and (6, bends), per mm of it
    """

    positions: Mapping[str, Array]
    motion: Mapping[str, Array]
    location: Mapping[str, Array]
    bends: tuple[Bend, ...]
    bend_motion: Mapping[str, Array]
    bend_location: Mapping[str, Array]

    def evaluate(self, rise_K: Array, speed_rpm: Array) -> Terms:
        """Return the terms at these temperature rises (t, N) and spindle speeds (t,)."""
        scale = TO_UM_URAD
        amounts = np.zeros((len(rise_K), len(self.bends)))
        for k, bend in enumerate(self.bends):
            amounts[:, k] = bend.amount(rise_K, speed_rpm)
        motion = {
            axis: scale[:, None]
            * (np.tensordot(rise_K, m, (1, 2)) + np.tensordot(amounts, self.bend_motion[axis], (1, 2)))
            for axis, m in self.motion.items()
        }
        location = {
            body: scale * (rise_K @ m.T + amounts @ self.bend_location[body].T) for body, m in self.location.items()
        }
        return Terms(self.positions, motion, location)


@dataclass(frozen=True)
class Terms:
    """Error terms over t samples [µm, µrad].

    Attributes
    ----------
    positions : of each axis, shape (n,) [mm, degree]
    motion : of each axis, shape (t, 6, n)
    location : of each axis, and of "T" and "W" where the machine has their terms, shape (t, 6)
    """

    positions: Mapping[str, Array]
    motion: Mapping[str, Array]
    location: Mapping[str, Array]

    def columns(self, machine: Machine) -> tuple[list[tuple[str, float | None]], Array]:
        """Return (term, position) of each column, in the machine's order of terms, and the values (t, columns)."""
        heads: list[tuple[str, float | None]] = []
        values = []
        for term in machine.terms:
            row = "XYZABC".index(term.direction)
            if term.kind == "motion":
                heads += [(term.name, float(p)) for p in self.positions[term.axis]]
                values.append(self.motion[term.axis][:, row])
            else:
                heads.append((term.name, None))
                values.append(self.location[term.axis][:, row, None])
        return heads, np.concatenate(values, axis=1)
