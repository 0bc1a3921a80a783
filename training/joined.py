"""Two data sets of one machine as one: training data beside the data to test on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from model.exceptions import DataError
from model.transforms import Array
from training.dataset import DataSet, MeasuredRun


def joined(test: DataSet, train: DataSet) -> DataSet:
    """Return the test data with the runs of the training data behind, named after their data set and themselves.

    Of the training data, only what the test data measures counts.

    Raises
    ------
    DataError
        where they are not of one machine, or the training data lacks an input or a term.
    """
    if train.machine.terms != test.machine.terms or train.machine.axes != test.machine.axes:
        raise DataError(
            f"--train-on '{train.path}' must be of a machine with the axes and error terms of '{test.path}', got "
            f"machine '{train.machine.name}' beside '{test.machine.name}'"
        )
    if train.datum != test.datum:
        raise DataError(f"--train-on '{train.path}' must have datum '{test.datum}' as '{test.path}' has")
    sensors = _order(train.sensors, test.sensors, "sensor", train)
    channels = _order(train.channels, test.channels, "channel", train)
    _order(train.terms, test.terms, "measurements of", train)
    wanted = [column for column in train.columns if column[0] in test.measured_terms]
    rank = test.machine.term_index
    columns = tuple(sorted({*test.columns, *wanted}, key=lambda c: (rank[c[0]], -np.inf if c[1] is None else c[1])))
    places = max(test.places, train.places)
    runs = {name: _arranged(run, test, columns, places) for name, run in test.runs.items()}
    for name, run in train.runs.items():
        telemetry = replace(
            run.telemetry,
            temperatures=run.telemetry.temperatures[:, sensors],
            channels=run.telemetry.channels[:, channels],
        )
        arranged = _arranged(replace(run, telemetry=telemetry), train, columns, places)
        if np.isfinite(arranged.values).any():
            runs[f"{train.path.name}/{name}"] = arranged
    return replace(test, columns=columns, runs=runs, places=places)


def _arranged(
    run: MeasuredRun, dataset: DataSet, columns: Sequence[tuple[str, float | None]], places: int
) -> MeasuredRun:
    """Return a run whose values are those of `columns`, and behind them the tip at so many places."""
    values = np.full((len(run.time_s), len(columns) + 3 * places), np.nan)
    for j, column in enumerate(dataset.columns):
        if column in columns:
            values[:, columns.index(column)] = run.values[:, j]
    tip = run.values[:, len(dataset.columns) :]
    values[:, len(columns) : len(columns) + tip.shape[1]] = tip
    at: Array | None = None
    if places:
        at = np.full((len(run.time_s), places, len(dataset.machine.axis_names)), np.nan)
        if run.places is not None:
            at[:, : run.places.shape[1]] = run.places
    return replace(run, values=values, places=at)


def _order(names: tuple[str, ...], wanted: tuple[str, ...], what: str, train: DataSet) -> list[int]:
    for name in wanted:
        if name not in names:
            raise DataError(f"--train-on '{train.path}' must have {what} '{name}', got {', '.join(names) or 'none'}")
    return [names.index(name) for name in wanted]
