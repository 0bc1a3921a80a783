"""Ridge regression: on the current temperatures, the industrial standard, and on moving averages of all inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.sensors import SensorModel
from model.transforms import Array
from training.baselines.inputs import TAUS_S
from training.baselines.normal import Normal, by_part, left_out_errors
from training.baselines.protocol import Task
from training.dataset import DataSet, MeasuredRun
from training.labels import patterns
from training.split import Split
from training.tip import TipMetric

PENALTIES = np.logspace(-6.0, 2.0, 25)
"""Candidate penalties, times the number of measurements; inputs are of size 1."""
BANKS: tuple[tuple[int, ...], ...] = (
    (),
    (2,),
    (3,),
    (4,),
    (1, 3),
    (2, 4),
    (3, 5),
    (1, 3, 5),
    (0, 2, 4),
    (0, 1, 2, 3, 4, 5),
)
"""Candidate sets of time constants, as numbers in `inputs.TAUS_S` (chosen: none, one, two or three at different
distances, all)."""


@dataclass(frozen=True)
class Ridge:
    """Ridge regression of the terms on the metric's grid; without intercept for run-start data.

    Attributes
    ----------
    chosen : which of the inputs and their averages it uses, flat in (S + C, 1 + K)
    weights : shape (p, G), with an intercept last for absolute data
    settings : that the left-out parts chose
    """

    task: Task
    chosen: NDArray[np.intp]
    weights: Array
    settings: dict[str, Any]

    def predict(self, run: MeasuredRun) -> Array:
        """Return the terms of a run on the metric's grid, shape (N, G) [µm, µrad]."""
        return _features(self.task, run)[:, _with_intercept(self.task, self.chosen)] @ self.weights


@dataclass(frozen=True)
class RidgeBaseline:
    """Ridge regression whose inputs, averages and penalty are those that predict left-out parts best at the tip.

    Attributes
    ----------
    banks : candidate sets of time constants
    channels : whether channels may be inputs beside the temperatures
    """

    name: str
    banks: Sequence[tuple[int, ...]]
    channels: bool

    def fit(self, task: Task) -> Ridge:
        """Learn from the training part."""
        x = np.concatenate([_features(task, run) for run in task.runs.values()])
        y = np.concatenate(list(task.targets.values()))
        part = np.concatenate([task.parts[name] for name in task.runs])
        known = part >= 0
        blocks = by_part(x[known], task.components.scores(y[known]), part[known])
        penalties = PENALTIES * int(known.sum())
        best, found = np.inf, (_columns(task, self.banks[0], channels=False), 0, self.banks[0])
        for bank in self.banks:
            for channels in sorted({False, self.channels and task.inputs.channels > 0}):
                chosen = _columns(task, bank, channels=channels)
                columns = _with_intercept(task, chosen)
                some = [[normal.of_columns(columns) for normal in block] for block in blocks]
                errors = left_out_errors(some, penalties, _free(task, len(columns)))
                i = int(np.argmin(errors)) if len(np.unique(part[known])) > 1 else len(penalties) // 2
                if errors[i] < best:
                    best, found = float(errors[i]), (chosen, i, bank)
        chosen, i, bank = found
        columns = _with_intercept(task, chosen)
        weights = np.zeros((len(columns), y.shape[1]))
        for rows, outputs in patterns(np.isfinite(y)):
            if rows.any():
                normal = Normal.of(x[np.ix_(rows, columns)], y[np.ix_(rows, outputs)])
                weights[:, outputs] = normal.solve(penalties[[i]], _free(task, len(columns)))[0]
        taus = [TAUS_S[k] for k in bank]
        settings: dict[str, Any] = {"penalty": float(PENALTIES[i])}
        if len(self.banks) > 1:
            settings |= {"time_constants_s": taus, "channels": len(chosen) > task.inputs.sensors * (1 + len(bank))}
        return Ridge(task, chosen, weights, settings)


RIDGE = RidgeBaseline("ridge regression", ((),), channels=False)
RIDGE_AVERAGES = RidgeBaseline("ridge, moving averages", BANKS, channels=True)


def fit_ridge(dataset: DataSet, split: Split, metric: TipMetric, sensor_model: SensorModel) -> Ridge:
    """Fit ridge regression on the current temperatures, the industrial standard."""
    return RIDGE.fit(Task(dataset, split, metric, sensor_model))


def _features(task: Task, run: MeasuredRun) -> Array:
    """Return all inputs and averages at the times of measurement, flat, and a one for the intercept, (N, p + 1)."""
    at = run.between(task.inputs.averages(run.telemetry)).reshape(len(run.time_s), -1)
    return np.concatenate([at, np.ones((len(at), 1))], axis=1)


def _columns(task: Task, bank: tuple[int, ...], *, channels: bool) -> NDArray[np.intp]:
    inputs = task.inputs.sensors + (task.inputs.channels if channels else 0)
    of_input = np.array([0, *(1 + k for k in bank)])
    columns: NDArray[np.intp] = np.arange(inputs)[:, None] * (1 + len(TAUS_S)) + of_input
    return columns.ravel()


def _with_intercept(task: Task, columns: NDArray[np.intp]) -> NDArray[np.intp]:
    if not task.intercept:
        return columns
    return np.append(columns, len(task.inputs.scale) * (1 + len(TAUS_S)))


def _free(task: Task, width: int) -> NDArray[np.bool_]:
    free: NDArray[np.bool_] = np.arange(width) == (width - 1 if task.intercept else -1)
    return free
