"""Put a trained network into a bundle, after proving that the exported file computes what torch computes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import torch

from model.bundle import Bundle, write_bundle
from model.exceptions import ComputeError
from model.fields import Fields
from model.manifest import LostSensorRecord, NetworkRecord, ParityRecord, UncertaintyRecord
from model.network import EXPORTER, OPSET, ThermalNetwork, export_onnx
from model.parity import PARITY_UM, check_parity, parity_record, sample_inputs
from model.sensors import SensorModel
from model.transforms import Array
from training.dataset import DataSet

PARITY_STEPS = 1440


def write_network(
    path: str | Path,
    dataset: DataSet,
    net: ThermalNetwork,
    fields: Fields,
    sensor_model: SensorModel,
    train_runs: Sequence[str],
    *,
    settling_time_s: float,
    training: dict[str, Any],
    test: dict[str, Any],
    uncertainty: UncertaintyRecord | None = None,
    lost_sensors: LostSensorRecord | None = None,
) -> Bundle:
    """Export a network, check it against torch, and write its bundle.

    `train_runs` are those that it was trained on: the valid ranges of its inputs are theirs alone.

    Raises
    ------
    ComputeError
        where the exported network differs from torch by more than `PARITY_UM`.
    BundleError
        where the bundle cannot be written, or would be refused wherever it is loaded.
    """
    exported = export_onnx(net)
    gap = parity(net, exported, dataset, sensor_model)
    if not gap <= PARITY_UM:
        raise ComputeError(f"the exported network must agree with torch to {PARITY_UM:g} µm, got {gap:.3g}")
    telemetry = [dataset.runs[name].telemetry for name in train_runs]
    ranges = _ranges(dataset.sensors, np.concatenate([run.temperatures for run in telemetry]))
    channel_ranges = _ranges(dataset.channels, np.concatenate([run.channels for run in telemetry]))
    record = NetworkRecord(
        sensors=list(dataset.sensors),
        channels=list(dataset.channels),
        terms=list(fields.terms),
        degree=fields.degree,
        modes=net.modes,
        time_constants_s=net.tau_s.tolist(),
        datum=dataset.datum,
        settling_time_s=settling_time_s,
        valid_range_degC=ranges,
        valid_range_channels=channel_ranges,
        sensor_mean_degC=sensor_model.mean.tolist(),
        sensor_covariance_K2=sensor_model.covariance.tolist(),
        opset=OPSET,
        exporter=EXPORTER,
        parity=parity_sample(net, fields, ranges, channel_ranges),
        uncertainty=uncertainty,
        lost_sensors=lost_sensors,
    )
    session = onnxruntime.InferenceSession(exported, providers=["CPUExecutionProvider"])
    check_parity(session, record, fields, f"bundle '{path}'")  # before an older bundle is replaced
    return write_bundle(
        path,
        dataset.machine,
        geometry=dataset.geometry,
        network=exported,
        record=record,
        training=training,
        test=test,
    )


def parity_sample(
    net: ThermalNetwork,
    fields: Fields,
    ranges: Mapping[str, tuple[float, float]],
    channel_ranges: Mapping[str, tuple[float, float]],
) -> ParityRecord:
    """Return what torch computes for a few steps, to be stored beside the network.

    Parameters
    ----------
    ranges, channel_ranges : of each sensor [°C] and each channel, in the order of the network's inputs
    """
    dt_s, inputs = sample_inputs(list(ranges.values()), list(channel_ranges.values()))
    with torch.no_grad():
        coefficients = net.decode(net.sequence(torch.tensor(inputs[None]), torch.tensor(dt_s[None])))[0].numpy()
    return parity_record(list(ranges), list(channel_ranges), fields, dt_s, inputs, coefficients)


def _ranges(names: Sequence[str], readings: Array) -> dict[str, tuple[float, float]]:
    lows, highs = np.nanmin(readings, axis=0), np.nanmax(readings, axis=0)
    return {name: (float(low), float(high)) for name, low, high in zip(names, lows, highs, strict=True)}


def parity(net: ThermalNetwork, exported: bytes, dataset: DataSet, sensor_model: SensorModel, seed: int = 0) -> float:
    """Return the largest difference of the exported step from torch's whole sequence [µm, µrad].

    The sequence is made of the data set's inputs in random order, gaps filled as they are in service, so it jumps as
    no machine does, with irregular steps from a tenth of a second to two hours, at batch sizes 1, 2 and 7.
    """
    rng = np.random.default_rng(seed)
    pool = np.concatenate(
        [
            np.concatenate([sensor_model.fill(r.telemetry.temperatures), r.telemetry.channels], axis=1)
            for r in dataset.runs.values()
        ]
    )
    session = onnxruntime.InferenceSession(exported, providers=["CPUExecutionProvider"])
    worst = 0.0
    for batch in (1, 2, 7):
        inputs = pool[rng.integers(0, len(pool), (batch, PARITY_STEPS // batch))]
        dt_s = np.exp(rng.uniform(np.log(0.1), np.log(7200.0), inputs.shape[:2]))
        dt_s[:, 0] = 0.0
        with torch.no_grad():
            expected = net.decode(net.sequence(torch.tensor(inputs), torch.tensor(dt_s))).numpy()
        modes = np.zeros((batch, net.modes))
        previous = inputs[:, 0]
        for t in range(inputs.shape[1]):
            fed = {
                "inputs": inputs[:, t],
                "previous": previous,
                "modes": modes,
                "dt_s": dt_s[:, t : t + 1],
                "fresh": np.full((batch, 1), float(t == 0)),
            }
            modes, coefficients = session.run(None, fed)
            previous = inputs[:, t]
            worst = max(worst, float(np.abs(coefficients - expected[:, t]).max()))
    return worst
