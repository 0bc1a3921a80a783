"""How much each time constant of the network moves the tip, over the runs it was trained on.

The time constants are a fixed ladder (`model.network.Prior`); the data decides through the decoder's weights how
much each counts. Parts may cancel: a fast and a slow mode of opposite sign together make a bump.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from model.sensors import SensorModel
from model.transforms import Array
from training.dataset import DataSet
from training.effects import volume_form
from training.trainer import Training


@dataclass(frozen=True)
class ModeWeights:
    """Root mean square over time, runs and the working volume of what a part of the decoder moves the tip [µm].

    Attributes
    ----------
    time_constants_s : of the modes, shape (K,)
    temperatures_um, sources_um : of all temperatures, and of all heat sources; the immediate effect first, then one
        per time constant, shape (K + 1,)
    residual_um : of the nonlinear residual, None where there is none
    """

    time_constants_s: Array
    temperatures_um: Array
    sources_um: Array
    residual_um: float | None


def mode_weights(dataset: DataSet, training: Training, sensor_model: SensorModel, runs: Sequence[str]) -> ModeWeights:
    """Return the weights, over the telemetry of `runs`; each is of the change since a run's first sample."""
    net = training.net
    tip = volume_form(training.fields)
    inputs, taus = len(net.warm), len(net.tau_s)
    warm = net.warm.numpy() > 0.0
    weights = net.linear.detach().numpy().reshape(inputs, taus + 1, -1)
    squares = np.zeros((2, taus + 1))
    residual = 0.0
    count = 0
    for name in runs:
        telemetry = dataset.runs[name].telemetry
        raw = np.concatenate([sensor_model.fill(telemetry.temperatures), telemetry.channels], axis=1)
        dt_s = np.diff(telemetry.time_s, prepend=telemetry.time_s[0])
        with torch.no_grad():
            features = net.sequence(torch.tensor(raw[None]), torch.tensor(dt_s[None]))[0]
            if net.residual is not None:
                added = (net.residual(features) - net.residual(features[:1])).numpy()
                residual += float(((added @ tip) * added).sum())
        change = (features - features[:1]).numpy().reshape(-1, inputs, taus + 1)
        for kind, chosen in enumerate((warm, ~warm)):
            for k in range(taus + 1):
                part = change[:, chosen, k] @ weights[chosen, k]
                squares[kind, k] += ((part @ tip) * part).sum()
        count += len(change)
    found = np.sqrt(np.maximum(squares, 0.0) / max(count, 1))
    left = None if net.residual is None else float(np.sqrt(max(residual, 0.0) / max(count, 1)))
    return ModeWeights(net.tau_s.numpy(), found[0], found[1], left)
