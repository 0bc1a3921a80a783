"""How the coefficients of the fields move the tool tip."""

from __future__ import annotations

import numpy as np

from model.chain import Chain
from model.fields import Fields
from model.terms import UM
from model.transforms import Array

GRID_POINTS = 3125
"""Most points of the grid below: five an axis of a machine with five (chosen)."""


def tip_effects(fields: Fields, q: Array) -> Array:
    """Return G(q) Φ(q), the tip's deviation [µm] by 1 µm or 1 µrad of each coefficient, (n, 3, P), at q (n, A)."""
    machine = fields.machine
    sensitivity = Chain(machine).sensitivity(q)[:, :3]
    effects = np.zeros((len(q), 3, fields.size))
    for name, where in fields.slices().items():
        term = machine.term(name)
        column = 0 if term.kind == "location" else machine.axis_names.index(term.axis)
        moved = sensitivity[:, :, machine.term_index[name]] * term.to_internal / UM
        effects[:, :, where] = moved[:, :, None] * fields.basis(name, q[:, column])[:, None, :]
    return effects


def tip_form(fields: Fields) -> Array:
    """Return the tip's mean square over the working volume [µm²] as a quadratic form of the coefficients, (P, P).

    Over a grid of five points an axis, fewer where the machine has many axes.
    """
    axes = [fields.machine.axes[a] for a in fields.machine.axis_names]
    points = min(5, int(GRID_POINTS ** (1.0 / max(len(axes), 1)) + 1e-9))
    grids = [np.linspace(axis.low, axis.high, max(points, 2)) for axis in axes]
    q = np.stack([g.ravel() for g in np.meshgrid(*grids, indexing="ij")], axis=1)
    effects = tip_effects(fields, q).reshape(-1, fields.size)
    form: Array = effects.T @ effects / len(q)
    return form
