"""What a practitioner would use instead of the network, tuned with the same care."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.sensors import SensorModel
from model.transforms import Array
from training.dataset import DataSet, MeasuredRun
from training.split import Split
from training.tip import TipMetric

PENALTIES = np.logspace(-3, 5, 17)
"""Candidate ridge penalties, in the units of squared kelvin times samples."""
FOLDS = 5
"""Parts that a single run's training time is cut into for choosing the penalty."""


@dataclass(frozen=True)
class Ridge:
    """Ridge regression of every term on the metric's grid on the current temperatures, the industrial standard.

    For run-start data it maps temperature changes since the run's first sample, without intercept; for absolute
    data the temperatures, with one.

    Attributes
    ----------
    weights : shape (S + 1, G), the intercept last
    penalty : chosen by leaving out parts of the training data
    """

    dataset: DataSet
    sensor_model: SensorModel
    weights: Array
    penalty: float

    def predict(self, run: MeasuredRun) -> Array:
        """Return the terms of a run on the metric's grid, shape (N, G) [µm, µrad]."""
        return _features(self.dataset, self.sensor_model, run) @ self.weights


def fit_ridge(dataset: DataSet, split: Split, metric: TipMetric, sensor_model: SensorModel) -> Ridge:
    """Fit on the training part; the penalty is the one that predicts left-out training parts best at the tip."""
    features: list[Array] = []
    values: list[Array] = []
    group: list[NDArray[np.intp]] = []
    single = len(split.train_runs) == 1
    for name in split.train_runs:
        run, mask = dataset.runs[name], split.train[name]
        features.append(_features(dataset, sensor_model, run)[mask])
        values.append(metric.sample(run.values[mask]))
        size = int(mask.sum())
        # Runs are left out whole; a single run is cut into stretches of time.
        group.append(np.arange(size) * FOLDS // size if single else np.full(size, len(group)))
    x, y, part = np.concatenate(features), np.concatenate(values), np.concatenate(group)
    errors = np.zeros(len(PENALTIES))
    for left_out in np.unique(part):
        inside = part != left_out
        normal = _NormalEquations(x[inside], y[inside])
        for i, penalty in enumerate(PENALTIES):
            residual = y[~inside] - x[~inside] @ normal.solve(penalty)
            errors[i] += metric.mean_square(residual).sum()
    penalty = float(PENALTIES[int(np.argmin(errors))])
    return Ridge(dataset, sensor_model, _NormalEquations(x, y).solve(penalty), penalty)


def _features(dataset: DataSet, sensor_model: SensorModel, run: MeasuredRun) -> Array:
    temperatures = sensor_model.fill(run.telemetry.temperatures)
    if dataset.datum == "run-start":
        change = run.between(temperatures - temperatures[0])
        return np.concatenate([change, np.zeros((len(change), 1))], axis=1)
    excess = run.between(temperatures - dataset.machine.reference_temperature_degC)
    return np.concatenate([excess, np.ones((len(excess), 1))], axis=1)


class _NormalEquations:
    """X'X and X'Y, once for all penalties; columns with gaps count only the rows they have."""

    def __init__(self, x: Array, y: Array) -> None:
        self._shape = (x.shape[1], y.shape[1])
        known = np.isfinite(y)
        patterns, which = np.unique(known, axis=1, return_inverse=True)
        self._parts = []
        for i, rows in enumerate(patterns.T):
            columns = np.flatnonzero(which.ravel() == i)
            self._parts.append((columns, x[rows].T @ x[rows], x[rows].T @ y[np.ix_(rows, columns)]))

    def solve(self, penalty: float) -> Array:
        """Return the ridge weights, shape (S + 1, G)."""
        weights = np.zeros(self._shape)
        for columns, square, product in self._parts:
            damping = penalty * np.eye(len(square))
            damping[-1, -1] = 1e-9 * max(square[-1, -1], 1.0)  # the intercept is not penalised
            weights[:, columns] = np.linalg.solve(square + damping, product)
        return weights
