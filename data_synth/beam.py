"""How a machine part deforms when its temperature is uneven.

Between sections along its axis the temperature and its gradient across the part run straight; across a section the
temperature is a plane. Such a part deforms as

    rotation  dω/ds = α g × t,      shift  du/ds = α θ t + ω × t

along its axis t, with θ the temperature rise there and g the gradient across; a point off the axis adds the
plane field's own expansion α [θ r + (g·r) r - g r²/2] and rotation α g × r. Where the temperature is linear in
space this is exact and free of stress (Boley and Weiner, Theory of Thermal Stresses, ch. 3). Only the warping of
sections by a gradient along the axis is left out: sections stay plane, and fields smooth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline

from data_synth.displacement import Displacement, cross
from data_synth.network import Array

Vector = tuple[float, float, float]
FAR_MM = 1e4  # beyond the outer sections the temperature stays as it is there


@dataclass(frozen=True)
class Section:
    """A cut through a part: where along the axis, and the nodes in it with their offsets from the axis [mm]."""

    at_mm: float
    nodes: Mapping[str, Vector]


@dataclass(frozen=True)
class Beam:
    """A machine part with its axis through `origin_mm` along the unit vector `along`."""

    origin_mm: Vector
    along: Vector
    sections: tuple[Section, ...]
    expansion_per_K: float

    def displacement(self, points_mm: ArrayLike, anchor_mm: ArrayLike, node: Mapping[str, int]) -> Displacement:
        """Return the displacement of points (n, 3) of the part relative to the part at its anchor (3,)."""
        points, anchor = np.atleast_2d(np.asarray(points_mm, dtype=np.float64)), np.atleast_2d(anchor_mm)
        there, here = self._free(points, node), self._free(anchor.astype(np.float64), node)
        base = here.carried(points - anchor)
        return Displacement(there.shift - base.shift, there.turn - base.turn)

    def _free(self, points: Array, node: Mapping[str, int]) -> Displacement:
        """Return the displacement relative to the unturned, unmoved axis at s = 0."""
        t = np.array(self.along)
        offset = points - np.array(self.origin_mm)
        s = offset @ t
        r = offset - s[:, None] * t
        rise, gradient = self._planes(node)  # (S, N), (S, 3, N)
        hat, once, twice = along_line(tuple(section.at_mm for section in self.sections), s)
        theta, g = hat @ rise, np.tensordot(hat, gradient, 1)
        omega = -cross(t, np.tensordot(once, gradient, 1))
        stretch = (once @ rise)[:, None, :] * t[:, None] - np.tensordot(twice, gradient, 1)
        along_r = np.einsum("ni,nik->nk", r, g)
        own = (theta + along_r)[:, None, :] * r[:, :, None] - 0.5 * (r**2).sum(1)[:, None, None] * g
        alpha = self.expansion_per_K
        return Displacement(alpha * (stretch - cross(r, omega) + own), alpha * (omega - cross(r, g)))

    def _planes(self, node: Mapping[str, int]) -> tuple[Array, Array]:
        """Return each section's temperature on the axis (S, N) and gradient (S, 3, N), by a least-squares plane.

        Where the nodes lie on a line, the gradient across that line is zero.
        """
        rise = np.zeros((len(self.sections), len(node)))
        gradient = np.zeros((len(self.sections), 3, len(node)))
        for k, section in enumerate(self.sections):
            at = np.array(list(section.nodes.values()))
            centre = at.mean(axis=0)
            slope = np.linalg.pinv(at - centre)  # (3, nodes); rows of what is centred sum to zero
            for j, name in enumerate(section.nodes):
                gradient[k, :, node[name]] = slope[:, j]
                rise[k, node[name]] = 1.0 / len(at) - centre @ slope[:, j]
        return rise, gradient


def along_line(knots_mm: tuple[float, ...], s_mm: Array) -> tuple[Array, Array, Array]:
    """Return hat functions of the knots at s and their first and second integrals from 0, shape (n, knots) each.

    What runs straight between knots, and stays constant beyond them, is its values at the knots times these.
    """
    knots = np.array([-FAR_MM, *knots_mm, FAR_MM])
    values = np.eye(len(knots_mm))
    hats = make_interp_spline(knots, np.vstack([values[:1], values, values[-1:]]), k=1)
    once, twice = hats.antiderivative(1), hats.antiderivative(2)
    at_zero, slope_at_zero = twice(0.0), once(0.0)
    return hats(s_mm), once(s_mm) - slope_at_zero, twice(s_mm) - at_zero - np.outer(s_mm, slope_at_zero)
