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
"""Predicts the measured columns of a run, shape (N, J) [µm, µrad]."""

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
        where nothing was left out, or nothing there moves the tip.
    """
    named: dict[str, Method] = {NO_COMPENSATION: lambda run: np.zeros_like(run.values), **methods}
    squares: dict[str, dict[str, Array]] = {name: {} for name in named}
    for run_name, mask in left_out.items():
        if not mask.any():
            continue
        run = dataset.runs[run_name]
        for name, method in named.items():
            squares[name][run_name] = metric.mean_square((run.values - method(run))[mask])
    if not squares[NO_COMPENSATION]:
        raise DataError(f"data set '{dataset.path}' must have measurements to test on, got none")
    base = _rms(squares[NO_COMPENSATION])
    if base == 0.0:
        raise DataError(f"the measured terms of data set '{dataset.path}' must move the tool tip; none of them does")
    return {
        name: Score(
            rms_um=_rms(by_run),
            share=_rms(by_run) / base,
            worst_um=float(np.sqrt(max(s.max() for s in by_run.values()))),
            by_run_um={run: float(np.sqrt(s.mean())) for run, s in by_run.items()},
        )
        for name, by_run in squares.items()
    }


def column_basis(fields: Fields, columns: tuple[Column, ...]) -> Array:
    """Return B, shape (J, size): measured columns = B @ coefficients; zero rows for terms the network lacks."""
    basis = np.zeros((len(columns), fields.size))
    slices = fields.slices()
    for j, (term, position) in enumerate(columns):
        if term in slices:
            basis[j, slices[term]] = fields.basis(term, np.array([0.0 if position is None else position]))[0]
    return basis


def network_method(predictor: Predictor, dataset: DataSet) -> Method:
    """Return the method that runs a bundle's network over a run, as the service would.

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
    sensors = [_position(dataset.sensors, name, "sensor", dataset) for name in predictor.sensors]
    channels = [_position(dataset.channels, name, "channel", dataset) for name in predictor.channels]
    basis = column_basis(predictor.fields, dataset.columns)

    def predict(run: MeasuredRun) -> Array:
        telemetry = run.telemetry
        chosen = Run(
            telemetry.name,
            telemetry.time_s,
            telemetry.temperatures[:, sensors],
            telemetry.channels[:, channels],
        )
        coefficients = predictor.follow(chosen)
        if dataset.datum == "run-start":
            coefficients = coefficients - coefficients[0]
        return run.between(coefficients) @ basis.T

    return predict


def _position(names: tuple[str, ...], wanted: str, what: str, dataset: DataSet) -> int:
    if wanted not in names:
        raise DataError(
            f"the network needs {what} '{wanted}', data set '{dataset.path}' has {', '.join(names) or 'none'}"
        )
    return names.index(wanted)


def _rms(by_run: Mapping[str, Array]) -> float:
    return float(np.sqrt(np.concatenate(list(by_run.values())).mean()))
