"""How the coefficients of the fields move the tool tip at positions."""

from __future__ import annotations

from model.fields import Fields
from model.tip_effects import tip_effects
from model.transforms import Array
from training.dataset import DataSet
from training.evaluation import column_basis
from training.tip import TipMetric
from training.volume import scattered_points


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
