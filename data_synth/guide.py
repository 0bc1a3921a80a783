"""From the path a body runs on to its error terms: a line fitted to the path is the location, the rest motion.

In the "motion-last" composition a body at axis position p is displaced by x0 + ω0 × (d p) + e(p) and turned by
ω0 + ε(p): d the direction it moves in, x0 and ω0 its location terms, e and ε its motion terms. The line is the
least-squares line over the axis' range; squareness is the turn ω0 of that line, roll's mean belongs to ω0 too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from data_synth.displacement import Displacement, cross
from data_synth.network import Array

GRID = 33  # positions over the range that the line is fitted to (chosen)


@dataclass(frozen=True)
class PathTerms:
    """Location terms, shape (6, N), and motion terms at n positions, shape (6, n, N); mm and rad per K."""

    location: Array
    motion: Array


def split(
    path: Callable[[Array], Displacement],
    direction: tuple[float, float, float],
    range_mm: tuple[float, float],
    at_mm: Array,
) -> PathTerms:
    """Return the terms of a path, which maps positions (n,) to the displacement of the body's origin there."""
    d = np.array(direction)
    grid = np.linspace(*range_mm, GRID)
    whole = path(grid)
    middle = grid.mean()
    weight = (grid - middle) / ((grid - middle) ** 2).sum()
    slope = np.tensordot(weight, whole.shift, 1)  # (3, N)
    roll = np.outer(d, d) @ whole.turn.mean(axis=0)
    turn = cross(d, slope[None])[0] + roll
    shift = whole.shift.mean(axis=0) + cross(d, turn[None])[0] * middle
    there = path(at_mm)
    line = Displacement(shift[None], turn[None]).carried(np.outer(at_mm, d))
    motion = np.concatenate([there.shift - line.shift, there.turn - line.turn], axis=1)  # (n, 6, N)
    return PathTerms(np.concatenate([shift, turn]), motion.transpose(1, 0, 2))
