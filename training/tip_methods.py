"""Predictions where the tip itself was measured: of the network, and of methods that know only terms on a grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from model.fields import Fields
from model.predictor import Predictor
from model.telemetry import Run
from model.tip_effects import tip_effects
from model.transforms import Array
from training.dataset import Column, DataSet, MeasuredRun
from training.decoder import kept
from training.evaluation import Method, column_basis, network_method
from training.information import gather
from training.labels import to_coefficients
from training.tip import TipMetric, tip_metric
from training.tip_decoder import Smoother

CORRELATION_S = 7200.0
"""Time over which terms are correlated that are identified without a thermal model [s] (chosen)."""
SURE = 50.0
"""Variance of the terms beside that of what a thermal model leaves of them: about seven times its size (chosen)."""


def measured_as(dataset: DataSet, metric: TipMetric, fields: Fields, run: MeasuredRun, coefficients: Array) -> Array:
    """Return coefficients (N, P) as the run's measurements would show them, shape (N, G + 3m)."""
    columns = coefficients @ column_basis(fields, dataset.columns).T
    parts = [columns]
    if run.places is not None:
        rows, places = np.nonzero(np.isfinite(run.places).all(axis=2))
        tip = np.full((len(run.time_s), dataset.places, 3), np.nan)
        tip[rows, places] = np.einsum("ndp,np->nd", tip_effects(fields, run.places[rows, places]), coefficients[rows])
        parts.append(tip.reshape(len(tip), -1))
    return metric.sample(np.where(np.isfinite(run.values), np.concatenate(parts, axis=1), np.nan))


def judged_network(predictor: Predictor, dataset: DataSet, metric: TipMetric) -> Method:
    """Return the method that runs a bundle's network over a run, whether terms or the tip were measured.

    Raises
    ------
    DataError
        as `evaluation.network_method`.
    """
    by_terms = network_method(predictor, dataset, metric)
    if not dataset.places:
        return by_terms
    sensors = [dataset.sensors.index(name) for name in predictor.sensors]
    channels = [dataset.channels.index(name) for name in predictor.channels]

    def predict(run: MeasuredRun) -> Array:
        seen = run.telemetry
        chosen = Run(seen.name, seen.time_s, seen.temperatures[:, sensors], seen.channels[:, channels])
        coefficients = predictor.follow(chosen)
        if dataset.datum == "run-start":
            coefficients = coefficients - coefficients[0]
        return measured_as(dataset, metric, predictor.fields, run, run.between(coefficients))

    return predict


def on_terms(fit: Callable[[DataSet, TipMetric], Method], dataset: DataSet, metric: TipMetric, degree: int) -> Method:
    """Return a method that learns terms on the metric's grid, such as the baselines.

    Where the tip was measured, the terms are identified from it first, run by run and without a thermal model, as a
    practitioner would; predictions are judged at the tip all the same.

    Parameters
    ----------
    fit : returns a trained method for a data set of terms and its metric
    degree : of the series of the identified terms
    """
    if not dataset.places:
        return fit(dataset, metric)
    fields = Fields(dataset.machine, dataset.terms, degree)
    identified = identify(dataset, metric, fields)
    grid = tip_metric(identified)
    method = fit(identified, grid)
    # The grid has as many points as a cubic has coefficients; of harmonics, the smallest that fit are taken.
    inverse = np.linalg.pinv(grid.from_columns(column_basis(fields, identified.columns)))
    return lambda run: measured_as(dataset, metric, fields, run, method(run) @ inverse.T)


def identify(dataset: DataSet, metric: TipMetric, fields: Fields) -> DataSet:
    """Return the data set with all terms on the metric's grid instead of what was measured."""
    positions = {
        name: np.zeros(1) if dataset.machine.term(name).kind == "location" else _grid(dataset, metric, name)
        for name in fields.terms
    }
    columns: tuple[Column, ...] = tuple(
        (name, None if dataset.machine.term(name).kind == "location" else float(p))
        for name, at in positions.items()
        for p in at
    )
    basis = column_basis(fields, columns)
    runs = {
        name: replace(run, values=_identified(dataset, metric, fields, run) @ basis.T, places=None)
        for name, run in dataset.runs.items()
    }
    return replace(dataset, columns=columns, runs=runs, places=0)


def _grid(dataset: DataSet, metric: TipMetric, name: str) -> Array:
    return np.unique(metric.positions[:, dataset.machine.axis_names.index(dataset.machine.term(name).axis)])


def _identified(dataset: DataSet, metric: TipMetric, fields: Fields, run: MeasuredRun) -> Array:
    """Return the coefficients (N, P) of a run: of the smoothest course that agrees with its measurements."""
    targets = to_coefficients(run.values, metric.coverage, fields)
    assert run.places is not None
    tip = run.values[:, len(dataset.columns) :].reshape(len(run.time_s), -1, 3)
    information = gather(fields, targets, run.places, tip)
    if information is None:
        return np.nan_to_num(targets)
    number = np.zeros(len(run.time_s), dtype=np.intp)
    process = Smoother(kept(run.time_s, number, CORRELATION_S), number, SURE * information.precision)
    found = information.directions.coefficients(process.smooth(SURE * information.vector))
    return np.where(np.isfinite(targets), targets, found)
