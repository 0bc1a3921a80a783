"""What all baselines have in common: what they are given, and what they give."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from model.sensors import SensorModel
from model.transforms import Array
from training.baselines.components import Components
from training.baselines.inputs import Inputs
from training.baselines.parts import parts
from training.dataset import DataSet, MeasuredRun
from training.split import Split
from training.tip import TipMetric


@dataclass(frozen=True)
class Task:
    """What a baseline is given to learn from; what is made of it is made once for all baselines.

    Attributes
    ----------
    split : only its training part is looked at
    sensor_model : fills in readings that are missing
    """

    dataset: DataSet
    split: Split
    metric: TipMetric
    sensor_model: SensorModel

    @property
    def runs(self) -> dict[str, MeasuredRun]:
        """Runs with measurements to learn from."""
        return {name: self.dataset.runs[name] for name in self.split.train_runs}

    @cached_property
    def inputs(self) -> Inputs:
        """What the baselines see of a run."""
        return Inputs.of(self.dataset, self.split.train_runs, self.sensor_model)

    @cached_property
    def targets(self) -> dict[str, Array]:
        """Terms on the metric's grid by run, each (N, G) [µm, µrad], NaN where not to be learned from."""
        found: dict[str, Array] = {}
        for name, run in self.runs.items():
            values = self.metric.sample(run.values)
            values[~self.split.train[name]] = np.nan
            found[name] = values
        return found

    @cached_property
    def parts(self) -> dict[str, NDArray[np.intp]]:
        """Number of the part that each measurement of a run belongs to; settings are chosen by leaving out parts."""
        return parts(self.dataset, self.split)

    @cached_property
    def components(self) -> Components:
        """The few numbers that say all of the terms that moves the tip."""
        return Components.of(np.concatenate(list(self.targets.values())), self.metric.gram)

    @property
    def intercept(self) -> bool:
        """Whether predictions may be other than zero at a run's first sample."""
        return self.dataset.datum == "absolute"

    def since_start(self, sampled: Array) -> Array:
        """Return predictions at telemetry samples (T, ...), less that at the first for run-start data."""
        return sampled if self.intercept else sampled - sampled[:1]


class Fitted(Protocol):
    """A baseline after training."""

    @property
    def settings(self) -> Mapping[str, Any]:
        """What the folds chose, for the report."""
        ...

    def predict(self, run: MeasuredRun) -> Array:
        """Return the terms of a run on the metric's grid at the times of measurement, (N, G) [µm, µrad].

        It sees the run's telemetry from its first sample on, and never its measurements.
        """
        ...


class Baseline(Protocol):
    """A baseline before training."""

    @property
    def name(self) -> str:
        """What tables call it."""
        ...

    def fit(self, task: Task) -> Fitted:
        """Learn from the training part; settings are chosen by leaving out parts of it."""
        ...
