"""Everything that training needs of a data set, as arrays: what the network sees and what it should say."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from model.exceptions import DataError
from model.fields import Fields
from model.network import InputScale, ThermalNetwork
from model.sensors import SensorModel
from model.transforms import Array
from training.coverage import Coverage
from training.dataset import DataSet, interpolation
from training.information import Information, gather
from training.labels import to_coefficients
from training.split import Mask


@dataclass(frozen=True)
class Samples:
    """The measurements of all runs, one after the other.

    Attributes
    ----------
    features : shape (N, F), the decoder's input; for run-start data minus that at the run's first sample
    first : shape (N, F), what was subtracted, zero for absolute data
    targets : shape (N, P), coefficients of the fields [µm, µrad], NaN where not measured
    run : shape (N,), number of the run
    time_s : shape (N,)
    information : what the measurements say where the tip was measured; None where the targets say it all
    """

    features: Array
    first: Array
    targets: Array
    run: NDArray[np.intp]
    time_s: Array
    information: Information | None = None

    def where(self, rows: NDArray[np.bool_]) -> Samples:
        """Return the samples of a mask."""
        information = None if self.information is None else self.information.where(rows)
        parts = (self.features[rows], self.first[rows], self.targets[rows], self.run[rows], self.time_s[rows])
        return Samples(*parts, information)

    def less(self, weights: Array, bias: Array) -> Samples:
        """Return what is left of the measurements when a linear decoder, (F, P) and (P,), has said its part."""
        said = self.features @ weights + bias
        information = None if self.information is None else self.information.less(said)
        return Samples(self.features, self.first, self.targets - said, self.run, self.time_s, information)


def input_scale(dataset: DataSet, train_runs: list[str], sensor_model: SensorModel) -> InputScale:
    """Return what brings the inputs of the training runs to about one.

    Absolute deviations are zero at the machine's reference temperature, so temperatures count from there; of
    run-start data only changes matter, and the mean serves as well.
    """
    readings = [sensor_model.fill(dataset.runs[name].telemetry.temperatures) for name in train_runs]
    within = np.concatenate([r - r.mean(axis=0) for r in readings])
    channels = np.concatenate([dataset.runs[name].telemetry.channels for name in train_runs])
    centre = (
        np.full(len(dataset.sensors), dataset.machine.reference_temperature_degC)
        if dataset.datum == "absolute"
        else np.concatenate(readings).mean(axis=0)
    )
    largest = np.abs(channels).max(axis=0)
    return InputScale(
        centre_degC=centre.tolist(),
        swing_K=float(np.sqrt((within**2).mean())) or 1.0,
        largest=np.where(largest > 0, largest, 1.0).tolist(),
        switched=[len(np.unique(c)) <= 2 for c in channels.T],
    )


def collect(
    net: ThermalNetwork,
    dataset: DataSet,
    masks: dict[str, Mask],
    coverage: Coverage,
    fields: Fields,
    sensor_model: SensorModel,
) -> Samples:
    """Run the network's modes over whole runs and take out the measurements of the masks.

    Raises
    ------
    DataError
        where they never show one of the terms.
    """
    parts: list[Samples] = []
    tips: list[tuple[Array, Array]] = []
    for number, (name, mask) in enumerate(masks.items()):
        if not mask.any():
            continue
        run = dataset.runs[name]
        telemetry = run.telemetry
        inputs = np.concatenate([sensor_model.fill(telemetry.temperatures), telemetry.channels], axis=1)
        dt_s = np.diff(telemetry.time_s, prepend=telemetry.time_s[0])
        with torch.no_grad():
            features = net.sequence(torch.tensor(inputs[None]), torch.tensor(dt_s[None]))[0].numpy()
        left, weight = interpolation(telemetry.time_s, run.time_s[mask])
        right = np.minimum(left + 1, len(features) - 1)
        at = features[left] * (1.0 - weight[:, None]) + features[right] * weight[:, None]
        first = np.broadcast_to(features[0] if dataset.datum == "run-start" else 0.0 * features[0], at.shape)
        targets = to_coefficients(run.values[mask], coverage, fields)
        parts.append(Samples(at - first, first, targets, np.full(len(at), number), run.time_s[mask]))
        if run.places is not None:
            tips.append((run.places[mask], run.values[mask, len(dataset.columns) :].reshape(len(at), -1, 3)))
    samples = Samples(
        features=np.concatenate([p.features for p in parts]),
        first=np.concatenate([p.first for p in parts]),
        targets=np.concatenate([p.targets for p in parts]),
        run=np.concatenate([p.run for p in parts]),
        time_s=np.concatenate([p.time_s for p in parts]),
    )
    if tips:
        q, deviation = (np.concatenate(part) for part in zip(*tips, strict=True))
        samples = replace(samples, information=gather(fields, samples.targets, q, deviation))
        if samples.information is not None:
            return samples
    for name in dataset.measured_terms:
        if not np.isfinite(samples.targets[:, fields.slices()[name]]).any():
            raise DataError(
                f"measurements to train on must show {name}, got it in the left-out part of '{dataset.path}' alone; "
                "leave out other runs (--test-runs)"
            )
    return samples
