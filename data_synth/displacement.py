"""Small rigid displacements as linear maps of the nodes' temperatures.

The last axis of every array runs over the N nodes of the thermal network: multiplied by their temperature rise [K]
it gives a shift [mm] or a rotation [rad]. Behind the nodes there may be columns of other small causes (see
`fields.Bend`), in mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from data_synth.network import Array


def cross(vectors: ArrayLike, maps: Array) -> Array:
    """Return vectors × maps: vectors (3,) or (n, 3), maps (n, 3, N)."""
    v = np.broadcast_to(np.asarray(vectors, dtype=np.float64), maps.shape[:-1])[..., None]
    product: Array = np.stack(
        [
            v[:, 1] * maps[:, 2] - v[:, 2] * maps[:, 1],
            v[:, 2] * maps[:, 0] - v[:, 0] * maps[:, 2],
            v[:, 0] * maps[:, 1] - v[:, 1] * maps[:, 0],
        ],
        axis=1,
    )
    return product


@dataclass(frozen=True)
class Displacement:
    """Displacements of n points: `shift` and `turn` (rotation vector), shape (n, 3, N) each.

    A single point's (n = 1) holds for all n in sums and differences.
    """

    shift: Array
    turn: Array

    def __add__(self, other: Displacement) -> Displacement:
        """Return one on top of the other."""
        return Displacement(self.shift + other.shift, self.turn + other.turn)

    def __sub__(self, other: Displacement) -> Displacement:
        """Return what one has beyond the other."""
        return Displacement(self.shift - other.shift, self.turn - other.turn)

    def carried(self, lever_mm: ArrayLike) -> Displacement:
        """Return the displacement of points of the same rigid body, (3,) or (n, 3) away: shift + turn × lever."""
        lever = np.atleast_2d(np.asarray(lever_mm, dtype=np.float64))
        n = max(len(lever), len(self.turn))
        turn = np.broadcast_to(self.turn, (n, *self.turn.shape[1:]))
        return Displacement(self.shift - cross(lever, turn), turn)

    def seen(self, rotation: Array) -> Displacement:
        """Return the same displacements in axes turned by `rotation`, shape (n, 3, 3): R v."""
        return Displacement(rotation @ self.shift, rotation @ self.turn)


def none(nodes: int) -> Displacement:
    """Return no displacement of a single point."""
    return Displacement(np.zeros((1, 3, nodes)), np.zeros((1, 3, nodes)))
