"""From the path a body runs on to its error terms.

"motion-last", a linear axis: at position p a body is displaced by x0 + ω0 × (d p) + e(p) and turned by ω0 + ε(p):
d the direction it moves in, x0 and ω0 its location terms, e and ε its motion terms. The location is the
least-squares line over the axis' range; squareness is the turn ω0 of that line, roll's mean belongs to ω0 too.

"motion-last", a rotary axis: it is displaced by x0 + R(q) e(q) and turned by ω0 + R(q) ε(q). x0 and ω0 are where the
axis' line stands (ISO 230-1: the average line): the least-squares fit, beside a part that turns with the body. What
turns with it, an eccentric or tilted table, is a constant motion term; along the line and about it the two cannot be
told apart, and the mean is location.

"seed": displaced by R(q) (x0 + e(q)), turned likewise; a location error turns no path, and a constant might stand in
either. The paper (section 3.3) finds all location terms two to three orders of magnitude below the motion terms but its
three squareness terms. So here everything is motion, with the slope of the path in the straightness, save the mean
turn that the squareness terms name and what the fixed connection of two bodies does, which eq. (4) is written for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from data_synth.displacement import Displacement, cross
from data_synth.network import Array

GRID = 33  # positions over the range that a line is fitted to (chosen)


@dataclass(frozen=True)
class PathTerms:
    """Location terms, shape (6, N), and motion terms at n positions, shape (6, n, N); mm and rad per K."""

    location: Array
    motion: Array


def split(
    path: Callable[[Array], Displacement],
    direction: tuple[float, float, float],
    limits: tuple[float, float],
    at: Array,
) -> PathTerms:
    """Return the terms of a linear axis' path, which maps positions (n,) to the displacement of the body's origin."""
    d = np.array(direction)
    grid = np.linspace(*limits, GRID)
    whole = path(grid)
    middle = grid.mean()
    weight = (grid - middle) / ((grid - middle) ** 2).sum()
    slope = np.tensordot(weight, whole.shift, 1)  # (3, N)
    roll = np.outer(d, d) @ whole.turn.mean(axis=0)
    turn = cross(d, slope[None])[0] + roll
    shift = whole.shift.mean(axis=0) + cross(d, turn[None])[0] * middle
    there = path(at)
    line = Displacement(shift[None], turn[None]).carried(np.outer(at, d))
    motion = np.concatenate([there.shift - line.shift, there.turn - line.turn], axis=1)  # (n, 6, N)
    return PathTerms(np.concatenate([shift, turn]), motion.transpose(1, 0, 2))


def split_rotary(
    path: Callable[[Array], Displacement],
    direction: tuple[float, float, float],
    limits: tuple[float, float],
    at: Array,
    rotations: Callable[[Array], Array],
) -> PathTerms:
    """Return the terms of a rotary axis' path; `rotations` maps positions to lower_R_body (n, 3, 3)."""
    d = np.array(direction)
    along = np.outer(d, d)
    grid = np.linspace(*limits, GRID)
    if np.allclose(rotations(grid[:1]), rotations(grid[-1:])):
        grid = grid[:-1]  # after whole turns the same place again: it counts once, and waves have no mean
    whole, rotation = path(grid), rotations(grid)
    standing = np.broadcast_to(np.eye(3) - along, rotation.shape)
    turning = rotation @ standing
    # x0 across the line, a part across it that turns with the body, and the mean along it.
    design = np.concatenate([standing, turning, np.broadcast_to(along, rotation.shape)], axis=2).reshape(-1, 9)
    # By its pseudo-inverse: each of the three blocks is of less than full rank.
    fit = np.linalg.pinv(design, rcond=1e-9)
    parts = [fit @ values.reshape(len(design), -1) for values in (whole.shift, whole.turn)]
    shift, turn = (values[:3] + values[6:] for values in parts)
    there = (path(at) - Displacement(shift[None], turn[None])).seen(rotations(at).transpose(0, 2, 1))
    motion = np.concatenate([there.shift, there.turn], axis=1)
    return PathTerms(np.concatenate([shift, turn]), motion.transpose(1, 0, 2))


def split_seed(
    path: Callable[[Array], Displacement],
    limits: tuple[float, float],
    at: Array,
    rotations: Callable[[Array], Array],
    squareness: frozenset[int],
    connection: Displacement,
) -> PathTerms:
    """Return the terms in the composition "seed".

    Parameters
    ----------
    squareness : rows of the location terms that take the mean turn
    connection : what fixes the body to its carriages, in its frame; all that is left to the location terms
    """
    grid = np.linspace(*limits, GRID)
    whole, there = (path(p).seen(rotations(p).transpose(0, 2, 1)) for p in (grid, at))
    location = np.concatenate([connection.shift[0], connection.turn[0]])
    rows = sorted(squareness)
    location[rows] = whole.turn.mean(axis=0)[[row - 3 for row in rows]]
    motion = np.concatenate([there.shift, there.turn], axis=1).transpose(1, 0, 2)
    return PathTerms(location, motion - location[:, None])
