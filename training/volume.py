"""The working volume, sampled: where the tool tip is judged."""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

from model.chain import Chain
from model.machine import Machine
from model.transforms import Array

POINTS_PER_AXIS = 4
"""The working volume is sampled on this grid, corners included: 64 points for three axes."""


SCATTERED = 1024
"""Points that a quadratic form over the volume is summed over, where the grid would not do (chosen)."""


def axis_grids(machine: Machine) -> list[Array]:
    """Return the sampled coordinates of each axis [mm, degree]."""
    return [np.linspace(machine.axes[a].low, machine.axes[a].high, POINTS_PER_AXIS) for a in machine.axis_names]


def volume_grid(machine: Machine) -> Array:
    """Return the sampled points of the working volume, shape (P, A) [mm, degree]."""
    return np.stack([g.ravel() for g in np.meshgrid(*axis_grids(machine), indexing="ij")], axis=1)


def scattered_points(machine: Machine) -> Array:
    """Return points that fill the working volume evenly, shape (SCATTERED, A) [mm, degree].

    On the grid, once and twice a turn of a rotary axis look the same.
    """
    axes = [machine.axes[a] for a in machine.axis_names]
    unit = qmc.Halton(len(axes), scramble=False).random(SCATTERED)
    points: Array = qmc.scale(unit, [axis.low for axis in axes], [axis.high for axis in axes])
    return points


def moving_terms(machine: Machine) -> tuple[str, ...]:
    """Return the terms that move the tool tip somewhere in the working volume, in the machine's order."""
    effect = np.abs(Chain(machine).sensitivity(volume_grid(machine))[:, :3]).max(axis=(0, 1))
    return tuple(term.name for term, size in zip(machine.terms, effect, strict=True) if size > 0.0)
