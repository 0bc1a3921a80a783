"""Which measurements train the network, and which are left out to test it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.exceptions import DataError
from training.dataset import DataSet, MeasuredRun

TEST_SHARE = 0.2
"""Share of the runs, or of a single run without spindle phases, that is left out."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Split:
    """A division of all measurements.

    Attributes
    ----------
    train, test : per run, which of its measurements; no measurement is in both
    description : what was left out, for the report
    """

    train: dict[str, Mask]
    test: dict[str, Mask]
    description: str

    @property
    def test_runs(self) -> list[str]:
        """Runs with measurements left out."""
        return [name for name, mask in self.test.items() if mask.any()]

    @property
    def train_runs(self) -> list[str]:
        """Runs with measurements to train on."""
        return [name for name, mask in self.train.items() if mask.any()]


def split_by_run(dataset: DataSet, test_runs: Sequence[str]) -> Split:
    """Leave out whole runs.

    Raises
    ------
    DataError
        where none would be left on one side.
    """
    if not test_runs:
        raise DataError("test runs must name at least one run, got none")
    left = [name for name in dataset.runs if name not in test_runs]
    if not left:
        raise DataError(
            f"test runs must leave runs to train on, got all {len(dataset.runs)} of '{dataset.path}'; name fewer"
        )
    train = {name: _all(run, name not in test_runs) for name, run in dataset.runs.items()}
    test = {name: _all(run, name in test_runs) for name, run in dataset.runs.items()}
    return Split(train, test, f"runs {', '.join(test_runs)}")


def default_split(dataset: DataSet, seed: int) -> Split:
    """Leave out a fifth of the runs, chosen by the seed; of a single run, its last spindle phase."""
    names = list(dataset.runs)
    if len(names) == 1:
        return _split_single(dataset, names[0])
    count = max(1, round(TEST_SHARE * len(names)))
    chosen = np.random.default_rng(seed).choice(len(names), count, replace=False)
    return split_by_run(dataset, [names[i] for i in sorted(chosen)])


def _split_single(dataset: DataSet, name: str) -> Split:
    run = dataset.runs[name]
    start_s, what = last_phase(dataset, run)
    later = run.time_s >= start_s
    if later.all() or not later.any():
        raise DataError(f"run '{name}' of '{dataset.path}' cannot be divided in time; record more than one run")
    hours = (run.time_s[-1] - start_s) / 3600.0
    return Split({name: ~later}, {name: later}, f"{what} ({hours:.1f} h from {start_s / 3600.0:.1f} h on)")


def last_phase(dataset: DataSet, run: MeasuredRun) -> tuple[float, str]:
    """Return when the last stretch of constant spindle speed begins, and a description of it.

    Without a channel `spindle_rpm`, or where the speed never rests, the last fifth of the time.
    """
    time_s = run.telemetry.time_s
    if "spindle_rpm" in dataset.channels:
        speed = run.telemetry.channels[:, dataset.channels.index("spindle_rpm")]
        changes = np.flatnonzero(np.diff(speed)) + 1
        if len(changes) and time_s[-1] - time_s[changes[-1]] > 0.02 * (time_s[-1] - time_s[0]):
            return float(time_s[changes[-1]]), f"the last spindle phase, {speed[-1]:g} rpm"
    return float(time_s[-1] - TEST_SHARE * (time_s[-1] - time_s[0])), "the last fifth of the run"


def everything(dataset: DataSet) -> Split:
    """Leave nothing out."""
    return Split(
        {name: _all(run, True) for name, run in dataset.runs.items()},
        {name: _all(run, False) for name, run in dataset.runs.items()},
        "nothing",
    )


def _all(run: MeasuredRun, value: bool) -> Mask:
    return np.full(len(run.time_s), value)
