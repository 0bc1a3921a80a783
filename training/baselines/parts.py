"""The parts of the training data that are left out in turn to choose settings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from training.dataset import DataSet, MeasuredRun
from training.split import Split

STRETCHES = 5
"""Parts of a single run without phases."""
SHORTEST_S = 1800.0
"""A spindle phase that was measured for less does not count as one (chosen)."""


def parts(dataset: DataSet, split: Split) -> dict[str, NDArray[np.intp]]:
    """Return the part of each measurement by run, -1 outside the training data.

    Runs are left out whole. A single run is cut into its phases of constant spindle speed, and where it has less than
    three, or no channel `spindle_rpm`, into stretches of time.
    """
    names = split.train_runs
    if len(names) > 1:
        return {name: np.where(split.train[name], i, -1) for i, name in enumerate(names)}
    found: dict[str, NDArray[np.intp]] = {}
    for name in names:
        run, mask = dataset.runs[name], split.train[name]
        number = np.full(len(mask), -1)
        phase = _phases(dataset, run)[mask]
        phase = np.unique(phase, return_inverse=True)[1].ravel()
        size = int(mask.sum())
        number[mask] = phase if phase.max() >= 2 else np.arange(size) * STRETCHES // size
        found[name] = number
    return found


def _phases(dataset: DataSet, run: MeasuredRun) -> NDArray[np.intp]:
    """Return the phase of each measurement, counted up by the changes of speed; short ones belong to the one before."""
    if "spindle_rpm" not in dataset.channels:
        return np.zeros(len(run.time_s), dtype=np.intp)
    speed = run.telemetry.channels[:, dataset.channels.index("spindle_rpm")]
    changes = run.telemetry.time_s[np.flatnonzero(np.diff(speed)) + 1]
    kept: list[float] = []
    for change in changes.tolist():
        if change - (kept[-1] if kept else run.time_s[0]) >= SHORTEST_S and run.time_s[-1] - change >= SHORTEST_S:
            kept.append(change)
    return np.searchsorted(np.array(kept), run.time_s, side="right")


def grouped(number: NDArray[np.intp], count: int) -> list[NDArray[np.bool_]]:
    """Return which rows are left out in turn, at most `count` times: parts are taken together, every so manyth.

    Empty where there is but one part.
    """
    known = np.unique(number[number >= 0])
    if len(known) < 2:
        return []
    return [np.isin(number, known[k::count]) for k in range(min(count, len(known)))]
