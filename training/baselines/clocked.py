"""Runs on an even clock, for methods that step from sample to sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.transforms import Array
from training.baselines.protocol import Task
from training.dataset import MeasuredRun

GAP = 3.0
"""Measurements that lie farther apart than this many typical gaps are not interpolated between."""


@dataclass(frozen=True)
class Clocked:
    """One run at even times from its first sample.

    Attributes
    ----------
    time_s : shape (K,)
    drive : shape (K, S + C), of `Inputs.drive`
    scores : shape (K, R) of the training measurements, NaN where there are none near
    part : shape (K,), the part of the training data, -1 where it belongs to none
    """

    time_s: Array
    drive: Array
    scores: Array
    part: NDArray[np.intp]


def clock(task: Task, run: MeasuredRun, step_s: float) -> tuple[Array, Array]:
    """Return even times (K,) that cover a run, and what drives the machine then, (K, S + C)."""
    start, end = run.telemetry.time_s[0], max(run.telemetry.time_s[-1], run.time_s[-1])
    time_s = start + step_s * np.arange(int(np.ceil((end - start) / step_s)) + 1)
    return time_s, _at(run.telemetry.time_s, task.inputs.drive(run.telemetry), time_s)


def read(time_s: Array, values: Array, run: MeasuredRun) -> Array:
    """Return what is known on the clock (K, R) at the times of measurement (N, R)."""
    return _at(time_s, values, run.time_s)


def training_runs(task: Task, step_s: float) -> list[Clocked]:
    """Return the training runs; scores are interpolated linearly between measurements that are near one another."""
    found: list[Clocked] = []
    for name, run in task.runs.items():
        time_s, drive = clock(task, run, step_s)
        scores = task.components.scores(task.targets[name])
        on_clock = np.full((len(time_s), scores.shape[1]), np.nan)
        for r in range(scores.shape[1]):
            rows = np.flatnonzero(np.isfinite(scores[:, r]))
            if len(rows) < 2:
                continue
            knots = run.time_s[rows]
            near = max(step_s, GAP * float(np.median(np.diff(knots))))
            right = np.clip(np.searchsorted(knots, time_s), 1, len(knots) - 1)
            # A measurement that is left out, or belongs to another part, stands between none of these.
            same = task.parts[name][rows][right - 1] == task.parts[name][rows][right]
            inside = (time_s >= knots[0]) & (time_s <= knots[-1]) & (knots[right] - knots[right - 1] <= near) & same
            on_clock[inside, r] = np.interp(time_s[inside], knots, scores[rows, r])
        nearest = np.clip(np.searchsorted(run.time_s, time_s), 0, len(run.time_s) - 1)
        found.append(Clocked(time_s, drive, on_clock, task.parts[name][nearest]))
    return found


def _at(knots: Array, values: Array, time_s: Array) -> Array:
    return np.stack([np.interp(time_s, knots, column) for column in values.T], axis=1)
