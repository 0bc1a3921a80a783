"""Gradient-boosted trees on temperatures, channels and their moving averages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingRegressor

from model.transforms import Array
from training.baselines.parts import grouped
from training.baselines.protocol import Task
from training.dataset import MeasuredRun

AVERAGES = (0, 2, 4, 6)
"""Of each input it sees itself, and averages over 400 s, 1 h and 10 h (numbers into `Inputs.averages`)."""
SHAPES = ((4, 40), (4, 10), (12, 40))
"""Candidate numbers of leaves, and of measurements in a leaf at least."""
MOST_TREES = 200
"""Trees, at most; how many is chosen by left-out parts, too."""
RATE = 0.15
"""Share of its correction that each tree makes (chosen: with it, the best number is seldom the most)."""
FOLDS = 4
"""Parts are left out in at most so many groups."""
APART_S = 120.0
"""Closer measurements are thinned out: they are no news (chosen)."""
LEAST = 1e-3
"""Scores with less than this share of the drift's mean square are left at zero: too small to pay for trees (chosen)."""
TELLING = 1e-2
"""Scores with at least this share choose the settings."""


@dataclass(frozen=True)
class Trees:
    """Boosted trees for each score.

    Attributes
    ----------
    boosted : by number of the score; the others are zero
    """

    task: Task
    boosted: dict[int, HistGradientBoostingRegressor]
    settings: dict[str, Any]

    def predict(self, run: MeasuredRun) -> Array:
        """Return the terms of a run on the metric's grid, shape (N, G) [µm, µrad]."""
        x = _features(self.task, run, with_start=True)
        scores = np.zeros((len(x), self.task.components.count))
        for r, trees in self.boosted.items():
            scores[:, r] = trees.predict(x)
        return self.task.components.grid(self.task.since_start(scores)[1:])


@dataclass(frozen=True)
class TreesBaseline:
    """Sizes and number of the trees are those that predict left-out parts best at the tip.

    Attributes
    ----------
    seed : of scikit-learn's generator
    """

    seed: int = 0
    name: str = "gradient-boosted trees"

    def fit(self, task: Task) -> Trees:
        """Learn from the training part."""
        thin = {name: _thinned(run.time_s) for name, run in task.runs.items()}
        x = np.concatenate([_features(task, run, with_start=False)[thin[n]] for n, run in task.runs.items()])
        y = np.concatenate([task.components.scores(task.targets[n][thin[n]]) for n in task.runs])
        part = np.concatenate([task.parts[n][thin[n]] for n in task.runs])
        energy = np.nansum(y**2, axis=0)
        best, found = np.inf, (*SHAPES[0], MOST_TREES)
        folds = grouped(part, FOLDS)
        for leaves, smallest in SHAPES if folds else ():
            errors = np.zeros(MOST_TREES)
            for r in np.flatnonzero(energy > TELLING * energy.sum()):
                known = np.isfinite(y[:, r]) & (part >= 0)
                for out in folds:
                    inside, outside = known & ~out, known & out
                    if not inside.any() or not outside.any():
                        continue
                    trees = self._boost(x[inside], y[inside, r], leaves, smallest, MOST_TREES)
                    for i, said in enumerate(trees.staged_predict(x[outside])):
                        errors[i] += float(((y[outside, r] - said) ** 2).sum())
            if errors.min() < best:
                best, found = float(errors.min()), (leaves, smallest, int(np.argmin(errors)) + 1)
        known = part >= 0
        boosted = {
            int(r): self._boost(x[known & np.isfinite(y[:, r])], y[known & np.isfinite(y[:, r]), r], *found)
            for r in np.flatnonzero(energy > LEAST * energy.sum())
        }
        return Trees(task, boosted, dict(zip(("leaves", "smallest_leaf", "trees"), found, strict=True)))

    def _boost(self, x: Array, y: Array, leaves: int, smallest: int, count: int) -> HistGradientBoostingRegressor:
        return HistGradientBoostingRegressor(
            learning_rate=RATE,
            max_iter=count,
            max_leaf_nodes=leaves,
            min_samples_leaf=smallest,
            early_stopping=False,
            random_state=self.seed,
        ).fit(x, y)


def _features(task: Task, run: MeasuredRun, *, with_start: bool) -> Array:
    """Return the inputs and averages (N, p) at the times of measurement, behind those of the first sample if wanted."""
    sampled = task.inputs.averages(run.telemetry)[:, :, AVERAGES]
    at = run.between(sampled)
    return (np.concatenate([sampled[:1], at]) if with_start else at).reshape(-1, sampled.shape[1] * sampled.shape[2])


def _thinned(time_s: Array) -> NDArray[np.intp]:
    """Return the rows that lie at least `APART_S` apart."""
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else APART_S
    return np.arange(0, len(time_s), max(int(np.ceil(APART_S / step)), 1))
