"""The worst moments: when the network is furthest off, and what the machine was doing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from model.transforms import Array
from training.dataset import DataSet
from training.evaluation import NETWORK, NO_COMPENSATION
from training.report.left_out import LeftOutRun
from training.tip import TipMetric

COUNT = 5
APART_S = 3600.0
"""Two moments of one run are so far apart (chosen), or they would all be of one peak."""
BEFORE_S = 3600.0
"""What the machine was doing is told for this long before the moment."""
SAID = 3
"""Terms named for each."""


@dataclass(frozen=True)
class Moment:
    """A time at which the network is far off.

    Attributes
    ----------
    run : with its left-out measurements
    row : measurement
    left_um, drift_um : residual of the network and drift, root mean square over the volume
    channels : by name, the value then and the mean over the hour before
    fastest : sensor that changed most over the hour before, and by how much [K]; None where there is no hour
    terms : those whose error moves the tip most, with what each alone leaves [µm]
    """

    run: LeftOutRun
    row: int
    left_um: float
    drift_um: float
    channels: dict[str, tuple[float, float]]
    fastest: tuple[str, float] | None
    terms: list[tuple[str, float]]

    @property
    def time_s(self) -> float:
        """Since power-on."""
        return float(self.run.measured.time_s[self.row])


def worst_moments(dataset: DataSet, metric: TipMetric, runs: Sequence[LeftOutRun]) -> list[Moment]:
    """Return the worst moments of the left-out measurements, worst first, an hour apart within a run."""
    peaks: list[tuple[float, LeftOutRun, int]] = []
    for run in runs:
        left = np.where(run.scored, np.nan_to_num(run.rms_um[NETWORK], nan=-1.0), -1.0)
        for _ in range(COUNT):
            row = int(np.argmax(left))
            if left[row] < 0.0:
                break
            peaks.append((float(left[row]), run, row))
            left = np.where(np.abs(run.measured.time_s - run.measured.time_s[row]) < APART_S, -1.0, left)
    peaks.sort(key=lambda peak: -peak[0])
    return [_moment(dataset, metric, run, row) for _, run, row in peaks[:COUNT]]


def _moment(dataset: DataSet, metric: TipMetric, run: LeftOutRun, row: int) -> Moment:
    telemetry, at_s = run.measured.telemetry, float(run.measured.time_s[row])
    now = int(np.searchsorted(telemetry.time_s, at_s, side="right")) - 1
    hour = (telemetry.time_s > at_s - BEFORE_S) & (telemetry.time_s <= at_s)
    means = telemetry.channels[hour].mean(axis=0) if hour.any() else telemetry.channels[now]
    return Moment(
        run,
        row,
        float(run.rms_um[NETWORK][row]),
        float(run.rms_um[NO_COMPENSATION][row]),
        {name: (float(telemetry.channels[now, i]), float(means[i])) for i, name in enumerate(dataset.channels)},
        _fastest(dataset, telemetry.temperatures[hour]),
        _terms(metric, (run.truth - run.said[NETWORK])[row]),
    )


def _fastest(dataset: DataSet, temperatures: Array) -> tuple[str, float] | None:
    if len(temperatures) < 2:
        return None
    change = np.nan_to_num(temperatures[-1] - temperatures[0])
    sensor = int(np.argmax(np.abs(change)))
    return dataset.sensors[sensor], float(change[sensor])


def _terms(metric: TipMetric, left: Array) -> list[tuple[str, float]]:
    alone: dict[str, float] = {}
    for name, where in metric.slices().items():
        only = np.full_like(left, np.nan)  # the tip's own measurements, too: this is what the term does
        only[where] = left[where]
        alone[name] = float(np.sqrt(metric.mean_square(only[None])[0]))
    moving = [item for item in alone.items() if item[1] > 0.0]  # others were not measured then, or are right
    return sorted(moving, key=lambda item: -item[1])[:SAID]
