"""Error terms of a machine as functions of its nodes' temperatures: a linear map and a few bends.

A structure (such as `cframe`) builds them; `Fields` evaluates them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from data_synth.network import Array
from data_synth.screw import Screw
from model.machine import Machine

TO_UM_URAD = np.array([1e3, 1e3, 1e3, 1e6, 1e6, 1e6])
"""From mm and rad to µm and µrad, for the six directions of a body's terms."""


@dataclass(frozen=True)
class Relief:
    """What a stretched screw adds to its axis' positioning: relief of the growth, times a profile of position.

    Attributes
    ----------
    growth : of the screw beyond the part that holds it, shape (N,) [mm/K]
    location, motion : shift per mm of relief, the mean and the rest at n positions (n,)
    """

    axis: str
    screw: Screw
    growth: Array
    location: float
    motion: Array


@dataclass(frozen=True)
class SpeedShift:
    """Axial shift of a spindle's nose with speed, not heat: ball bearings under centrifugal load (grows as n²).

    `um` is that at `at_rpm`; some micrometres, chosen.
    """

    um: float
    at_rpm: float


@dataclass(frozen=True)
class Fields:
    """All error terms.

    Attributes
    ----------
    positions_mm : of each axis, shape (n,)
    motion : of each axis, shape (6, n, N), mm and rad per K
    location : of each axis and of "T", shape (6, N)
    """

    positions_mm: Mapping[str, Array]
    motion: Mapping[str, Array]
    location: Mapping[str, Array]
    reliefs: tuple[Relief, ...]
    speed_shift: SpeedShift

    def evaluate(self, rise_K: Array, speed_rpm: Array) -> Terms:
        """Return the terms at these temperature rises (t, N) and spindle speeds (t,)."""
        scale = TO_UM_URAD
        motion = {axis: scale[:, None] * np.tensordot(rise_K, m, (1, 2)) for axis, m in self.motion.items()}
        location = {body: scale * (rise_K @ m.T) for body, m in self.location.items()}
        for relief in self.reliefs:
            direction = "XYZ".index(relief.axis)
            pushed = 1e3 * relief.screw.relief(rise_K @ relief.growth)
            motion[relief.axis][:, direction] += pushed[:, None] * relief.motion
            location[relief.axis][:, direction] += pushed * relief.location
        location["T"][:, 2] += self.speed_shift.um * (speed_rpm / self.speed_shift.at_rpm) ** 2
        return Terms(self.positions_mm, motion, location)


@dataclass(frozen=True)
class Terms:
    """Error terms over t samples [µm, µrad].

    Attributes
    ----------
    positions_mm : of each axis, shape (n,)
    motion : of each axis, shape (t, 6, n)
    location : of each axis and of "T", shape (t, 6)
    """

    positions_mm: Mapping[str, Array]
    motion: Mapping[str, Array]
    location: Mapping[str, Array]

    def columns(self, machine: Machine) -> tuple[list[tuple[str, float | None]], Array]:
        """Return (term, position) of each column, in the machine's order of terms, and the values (t, columns)."""
        heads: list[tuple[str, float | None]] = []
        values = []
        for term in machine.terms:
            row = "XYZABC".index(term.direction)
            if term.kind == "motion":
                heads += [(term.name, float(p)) for p in self.positions_mm[term.axis]]
                values.append(self.motion[term.axis][:, row])
            else:
                heads.append((term.name, None))
                values.append(self.location[term.axis][:, row, None])
        return heads, np.concatenate(values, axis=1)
