"""How the network's 95 % interval does on left-out measurements."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from model.predictor import Predictor
from model.transforms import Array
from model.uncertainty import NORMAL_95, Uncertainty
from training.coverage import by_pattern
from training.dataset import DataSet, MeasuredRun
from training.evaluation import Method, chosen_inputs, column_basis, scored_rows
from training.split import Mask
from training.tip import TipMetric

Spread = Callable[[MeasuredRun], Array]
"""Says how many times as far off as usual the prediction may be at the times of measurement, shape (N,)."""


@dataclass(frozen=True)
class Interval:
    """How the 95 % interval of a prediction did on left-out measurements, at the tip in x, y and z.

    Attributes
    ----------
    within : share of the deviations over the working volume, or at the measured places, that lie within it
    half_width_um : mean of what it allows to either side
    count : deviations that were compared
    by_run : the same of each run
    """

    within: float
    half_width_um: float
    count: int
    by_run: dict[str, Interval]

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        found = {"level": 0.95, "within": self.within, "half_width_um": self.half_width_um}
        by_run = {n: {"within": i.within, "half_width_um": i.half_width_um} for n, i in self.by_run.items()}
        return {**found, "by_run": by_run}


def interval(
    dataset: DataSet,
    left_out: Mapping[str, Mask],
    method: Method,
    spread: Spread,
    uncertainty: Uncertainty,
    metric: TipMetric,
) -> Interval:
    """Compare what a method leaves of the measurements in `left_out` with the interval that it claims.

    Axes and places that no measured term moves are not counted.
    """
    found: dict[str, Interval] = {}
    for name, mask in scored_rows(dataset, left_out, metric).masks.items():
        run = dataset.runs[name]
        residual = (metric.sample(run.values) - method(run))[mask]
        places = None if run.places is None else run.places[mask]
        usual, off = _usual_and_off(dataset, metric, uncertainty, residual, places)
        allowed = NORMAL_95 * uncertainty.whole(usual, spread(run)[mask])
        counted = np.isfinite(off) & (usual > 1e-9)
        within = float((off <= allowed)[counted].mean()) if counted.any() else 1.0
        width = float(allowed[counted].mean()) if counted.any() else 0.0
        found[name] = Interval(within, width, int(counted.sum()), {})
    whole = pooled(list(found.values()))
    return Interval(whole.within, whole.half_width_um, whole.count, found)


def pooled(intervals: Sequence[Interval]) -> Interval:
    """Return one interval of several, each counted by its deviations."""
    count = np.array([i.count for i in intervals], dtype=float)
    share = count / max(count.sum(), 1.0)
    within = float(share @ np.array([i.within for i in intervals]))
    return Interval(within, float(share @ np.array([i.half_width_um for i in intervals])), int(count.sum()), {})


def _usual_and_off(
    dataset: DataSet, metric: TipMetric, uncertainty: Uncertainty, residual: Array, places: Array | None
) -> tuple[Array, Array]:
    """Return the usual standard deviation and the residual's size at the tip [µm], both (n, points), NaN if unknown.

    Over the volume by the terms that each row shows; where the tip was measured, at its places.
    """
    size = metric.matrix.shape[2]
    grid = metric.from_columns(column_basis(uncertainty.fields, dataset.columns))[:size] @ uncertainty.directions.T
    points = 3 * max(len(metric.positions), metric.places)
    usual, off = np.zeros((len(residual), points)), np.full((len(residual), points), np.nan)
    flat = metric.matrix.reshape(3 * len(metric.positions), size)
    known = np.isfinite(residual[:, :size])
    for pattern, rows in by_pattern(known):
        some = flat[:, pattern]
        usual[rows, : len(flat)] = np.sqrt(((some @ grid[pattern]) ** 2).sum(axis=1))
        off[rows, : len(flat)] = np.abs(residual[np.ix_(rows, np.flatnonzero(pattern))] @ some.T)
    if places is not None:
        touched = np.isfinite(residual[:, size:])
        if metric.complete:
            touched &= ~known.all(axis=1, keepdims=True)
        there = np.flatnonzero(touched.any(axis=1))
        usual[there], off[there] = 0.0, np.nan
        row, place = np.nonzero(touched.reshape(len(residual), -1, 3).any(axis=2))
        at = 3 * place[:, None] + np.arange(3)
        usual[row[:, None], at] = uncertainty.usual_tip(places[row, place])
        off[row[:, None], at] = np.abs(residual[:, size:])[row[:, None], at]
    return usual, off


def network_interval(
    dataset: DataSet, left_out: Mapping[str, Mask], method: Method, predictor: Predictor, metric: TipMetric
) -> Interval | None:
    """Compare a bundle's network with its own interval, or None where the bundle does not give one."""
    if predictor.uncertainty is None:
        return None
    return interval(dataset, left_out, method, network_spread(predictor, dataset), predictor.uncertainty, metric)


def network_spread(predictor: Predictor, dataset: DataSet) -> Spread:
    """Return what says how far off a bundle's network may be."""

    def spread(run: MeasuredRun) -> Array:
        return run.between(predictor.spread(predictor.states(chosen_inputs(predictor, dataset, run))))

    return spread
