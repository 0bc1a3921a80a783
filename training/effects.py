"""How the coefficients of the fields move the tool tip at positions."""

from __future__ import annotations

import numpy as np

from model.chain import Chain
from model.fields import Fields
from model.terms import UM
from model.transforms import Array
from training.dataset import DataSet
from training.evaluation import column_basis
from training.tip import TipMetric
from training.volume import scattered_points


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


def volume_form(fields: Fields) -> Array:
    """Return the tip's mean square over the working volume [µm²] as a quadratic form of the coefficients, (P, P)."""
    q = scattered_points(fields.machine)
    effects = tip_effects(fields, q).reshape(-1, fields.size)
    form: Array = effects.T @ effects / len(q)
    return form


def judged_form(dataset: DataSet, metric: TipMetric, fields: Fields) -> Array:
    """Return the quadratic form that judges coefficients (P, P): by the measured columns, or over the whole volume."""
    if metric.places and not metric.complete:
        return volume_form(fields)
    basis = metric.from_columns(column_basis(fields, dataset.columns))
    form: Array = basis.T @ metric.gram @ basis
    return form
