"""Residual tool-tip deviation on left-out measurements, of several methods side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from model.exceptions import DataError
from model.fields import Fields
from model.predictor import Predictor
from model.telemetry import Run
from model.transforms import Array
from training.dataset import Column, DataSet, MeasuredRun
from training.split import Mask
from training.tip import TipMetric

Method = Callable[[MeasuredRun], Array]
"""Predicts the terms of a run on the metric's grid at the times of measurement, shape (N, G) [µm, µrad]."""

NO_COMPENSATION, RIDGE, NETWORK = "no compensation", "ridge regression", "thermal network"


@dataclass(frozen=True)
class Score:
    """Residual at the tip, over the working volume and the left-out measurements.

    Attributes
    ----------
    rms_um : root mean square of the residual deviation vector
    share : that, divided by its value without compensation
    worst_um : largest root mean square over the volume at any one time
    by_run_um : rms_um run by run
    """

    rms_um: float
    share: float
    worst_um: float
    by_run_um: dict[str, float]

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {"rms_um": self.rms_um, "share": self.share, "worst_um": self.worst_um, "by_run_um": self.by_run_um}


def compare(
    dataset: DataSet, left_out: Mapping[str, Mask], methods: Mapping[str, Method], metric: TipMetric
) -> dict[str, Score]:
    """Score each method on the measurements in `left_out`, beside no compensation.

    Raises
    ------
    DataError
        where nothing was left out, no term moves the tip, or nothing there drifted.
    """
    if not metric.gram.max() > 0.0:
        raise DataError(f"the measured terms of data set '{dataset.path}' must move the tool tip; none of them does")
    scored = scored_rows(dataset, left_out, metric)
    if not scored.masks:
        raise DataError(f"data set '{dataset.path}' must have measurements to test on, got none")
    named: dict[str, Method] = {NO_COMPENSATION: lambda run: np.zeros((len(run.values), len(metric.gram))), **methods}
    squares: dict[str, dict[str, Array]] = {name: {} for name in named}
    for run_name, mask in scored.masks.items():
        run = dataset.runs[run_name]
        truth = metric.sample(run.values)
        for name, method in named.items():
            squares[name][run_name] = metric.mean_square((truth - method(run))[mask])
    base = _rms(squares[NO_COMPENSATION])
    if base == 0.0:
        raise DataError(
            f"measurements to test on in data set '{dataset.path}' must show some drift, got values that leave the "
            f"tool tip where it was in runs {', '.join(scored.masks)}"
        )
    return {
        name: Score(
            rms_um=_rms(by_run),
            share=_rms(by_run) / base,
            worst_um=float(np.sqrt(max(s.max() for s in by_run.values()))),
            by_run_um={run: float(np.sqrt(s.mean())) for run, s in by_run.items()},
        )
        for name, by_run in squares.items()
    }


@dataclass(frozen=True)
class Scored:
    """The left-out measurements that are scored.

    Attributes
    ----------
    masks : per run; runs without any are not named
    note : which of them are not scored, or how; empty where all show all terms
    """

    masks: dict[str, Mask]
    note: str


def scored_rows(dataset: DataSet, left_out: Mapping[str, Mask], metric: TipMetric) -> Scored:
    """Return which left-out measurements are scored: those that show all terms.

    Where none does, since the terms were measured at different times, each counts by the terms that it shows.
    """
    sampled = {name: metric.sample(dataset.runs[name].values) for name, mask in left_out.items() if mask.any()}
    total = sum(int(left_out[name].sum()) for name in sampled)
    whole = {name: left_out[name] & metric.whole(s) for name, s in sampled.items()}
    part = {name: left_out[name] & np.isfinite(s).any(axis=1) for name, s in sampled.items()}
    chosen = whole if any(mask.any() for mask in whole.values()) else part
    masks = {name: mask for name, mask in chosen.items() if mask.any()}
    count = sum(int(mask.sum()) for mask in masks.values())
    if chosen is part and masks:
        return Scored(masks, f"none of {total} measurements shows all terms: each is scored by the terms that it shows")
    if count < total:
        return Scored(masks, f"{total - count} of {total} measurements do not show all terms and are not scored")
    return Scored(masks, "")


def chosen_inputs(predictor: Predictor, dataset: DataSet, run: MeasuredRun) -> Run:
    """Return a run's telemetry with the network's inputs alone, in its order."""
    sensors = [_position(dataset.sensors, name, "sensor", dataset) for name in predictor.sensors]
    channels = [_position(dataset.channels, name, "channel", dataset) for name in predictor.channels]
    seen = run.telemetry
    return Run(seen.name, seen.time_s, seen.temperatures[:, sensors], seen.channels[:, channels])


def column_basis(fields: Fields, columns: tuple[Column, ...]) -> Array:
    """Return B, shape (J, size): measured columns = B @ coefficients; zero rows for terms the network lacks."""
    basis = np.zeros((len(columns), fields.size))
    slices = fields.slices()
    for j, (term, position) in enumerate(columns):
        if term in slices:
            basis[j, slices[term]] = fields.basis(term, np.array([0.0 if position is None else position]))[0]
    return basis


def network_method(predictor: Predictor, dataset: DataSet, metric: TipMetric) -> Method:
    """Return the method that runs a bundle's network over a run, as the service would.

    Its prediction is read at the positions that were measured at each time, as the truth is.

    Raises
    ------
    DataError
        where the data set lacks an input of the network, or asks for absolute deviations of a network that knows
        only changes.
    """
    if predictor.datum == "run-start" and dataset.datum == "absolute":
        raise DataError(
            f"data set '{dataset.path}' has absolute deviations, the bundle was trained on changes since run-start; "
            'set datum = "run-start" in dataset.toml or train on absolute data'
        )
    chosen_inputs(predictor, dataset, next(iter(dataset.runs.values())))  # a missing input is better known now
    basis = column_basis(predictor.fields, dataset.columns)

    def predict(run: MeasuredRun) -> Array:
        coefficients = predictor.follow(chosen_inputs(predictor, dataset, run))
        if dataset.datum == "run-start":
            coefficients = coefficients - coefficients[0]
        columns = run.between(coefficients) @ basis.T
        return metric.sample(np.where(np.isfinite(run.values), columns, np.nan))

    return predict


def _position(names: tuple[str, ...], wanted: str, what: str, dataset: DataSet) -> int:
    if wanted not in names:
        raise DataError(
            f"the network needs {what} '{wanted}', data set '{dataset.path}' has {', '.join(names) or 'none'}"
        )
    return names.index(wanted)


def _rms(by_run: Mapping[str, Array]) -> float:
    return float(np.sqrt(np.concatenate(list(by_run.values())).mean()))
