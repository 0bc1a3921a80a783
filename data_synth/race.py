"""The two rings of a rotary axis' bearing, which grow apart where one is warmer, and not roundly.

A ring is held by screws and seats of uneven stiffness, so a share of what it grows more than the other comes as
run-out, proportional to the difference of their temperatures: error motions that change with heat, as an R-test
follows them (Ibaraki and Hong, Key Eng. Mater. 523-524 (2012) 809). The turning ring gives way to one side, which goes
round with the body: once per turn. The standing ring becomes oval, which the body passes twice per turn. That is a
simple pattern of radial, axial and tilt error motion (ISO 230-7); its phases are those of one machine, chosen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from data_synth.displacement import Displacement
from data_synth.materials import STEEL
from data_synth.network import Array

SECOND = 0.5  # what comes twice per turn as a share of what comes once, as in cold errors (chosen)


@dataclass(frozen=True)
class Race:
    """A bearing's two rings.

    With a ring of 300 mm and 5 K between the two, their diameters differ by 17 µm; a share of 0.1 of that is a run-out
    of 1.7 µm and, over half the diameter, a tilt of 12 µrad; as a cold table has it (see `Workmanship`).

    Attributes
    ----------
    diameter_mm : of the rollers' path
    turning, standing : nodes of the two rings, with shares that sum to 1 each
    phase_degree : where, from the first direction across, the turning ring gives way
    share : of the rings' difference in diameter that is not round: a tenth, as much as clamping is uneven (chosen)
    """

    diameter_mm: float
    turning: Mapping[str, float]
    standing: Mapping[str, float]
    phase_degree: float = 0.0
    share: float = 0.1

    def displacement(
        self, direction: ArrayLike, angle: Array, rotation: Array, node: Mapping[str, int], columns: int
    ) -> Displacement:
        """Return how the rings displace the turning body, at their middle, in the lower body's axes.

        Parameters
        ----------
        direction : unit vector along the axis' line, (3,)
        angle : of the axis, (n,) [rad]
        rotation : lower_R_body there, (n, 3, 3)
        columns : length of the maps
        """
        d = np.asarray(direction, dtype=np.float64)
        across = np.eye(3)[(int(np.argmax(np.abs(d))) + 1) % 3]  # of x, y, z the one that follows the axis' own
        first = across - (across @ d) * d
        first /= np.linalg.norm(first)
        phase = np.radians(self.phase_degree)
        side = np.cos(phase) * first + np.sin(phase) * np.cross(d, first)
        once, twice = np.cos(angle - phase), SECOND * np.cos(2.0 * (angle - phase))
        size = self._run_out(node, columns)
        radial = rotation @ side * (1.0 + twice)[:, None]  # (n, 3)
        axial = d * (once + twice)[:, None]
        # Its face leans too, by as much at the rim; at right angles to where it gives way, so that at no height above
        # the bearing the two cancel (chosen).
        tilt = radial / (0.5 * self.diameter_mm)
        return Displacement((radial + axial)[:, :, None] * size, tilt[:, :, None] * size)

    def _run_out(self, node: Mapping[str, int], columns: int) -> Array:
        """Return the run-out, shape (columns,) [mm/K]."""
        size = np.zeros(columns)
        for shares, sign in ((self.turning, 1.0), (self.standing, -1.0)):
            for name, share in shares.items():
                size[node[name]] += sign * share * self.share * STEEL.expansion_per_K * self.diameter_mm
        return size
