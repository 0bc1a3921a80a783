"""Baselines, trained on the training part of a split: what the network is judged beside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from model.progress import Reporter
from model.sensors import SensorModel
from training.baselines.everyone import BASELINES
from training.baselines.protocol import Baseline, Task
from training.checkpoint import Stored
from training.dataset import DataSet, MeasuredRun
from training.evaluation import Method
from training.split import Split
from training.tip import TipMetric
from training.tip_methods import on_terms


@dataclass(frozen=True)
class Trained:
    """A baseline after training.

    Attributes
    ----------
    settings : that left-out parts of the training data chose
    """

    predict: Method
    settings: Mapping[str, Any]

    def stored(self, runs: Mapping[str, MeasuredRun]) -> Stored:
        """Return for a checkpoint what it says of some runs."""
        return Stored(
            {f"run.{i}": self.predict(run) for i, run in enumerate(runs.values())},
            {"runs": list(runs), "settings": dict(self.settings)},
        )

    @classmethod
    def restored(cls, stored: Stored) -> Trained:
        """Return what `stored` keeps; it speaks of no other runs."""
        said = {name: stored.arrays[f"run.{i}"] for i, name in enumerate(stored.rest["runs"])}
        return cls(lambda run: said[run.telemetry.name], stored.rest["settings"])


def fit_baseline(baseline: Baseline, dataset: DataSet, split: Split, metric: TipMetric, degree: int) -> Trained:
    """Return a baseline trained on the training part of a split; `degree` is that of the series of terms.

    Where the tip was measured instead of the terms, these are identified first.
    """
    sensors = SensorModel.fit(np.concatenate([dataset.runs[n].telemetry.temperatures for n in split.train_runs]))
    settings: dict[str, Any] = {}

    def fit(terms: DataSet, grid: TipMetric) -> Method:
        fitted = baseline.fit(Task(terms, split, grid, sensors))
        settings.update(fitted.settings)
        return fitted.predict

    return Trained(on_terms(fit, dataset, metric, degree), settings)


def fit_baselines(
    dataset: DataSet, split: Split, metric: TipMetric, degree: int, baselines: Sequence[Baseline] = BASELINES
) -> dict[str, Trained]:
    """Return several of them by name."""
    found: dict[str, Trained] = {}
    with Reporter("training baselines", len(baselines)) as reporter:
        for baseline in baselines:
            found[baseline.name] = fit_baseline(baseline, dataset, split, metric, degree)
            reporter.advance(baseline.name)
    return found
