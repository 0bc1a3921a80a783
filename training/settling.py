"""How long telemetry must have run until the unknown state at its start hardly matters."""

from __future__ import annotations

import numpy as np

from model.predictor import Predictor
from model.telemetry import Run
from model.transforms import Array
from training.dataset import DataSet
from training.effects import judged_form
from training.tip import TipMetric

HARDLY = 0.1
"""Share of the run's own drift below which a wrong start no longer matters (chosen)."""


def settling_time_s(predictor: Predictor, dataset: DataSet, metric: TipMetric) -> float:
    """Return the time after which a network started in the middle of a run agrees with one that saw all of it.

    A service that is switched on with a warm machine takes the thermal modes to be in equilibrium, which they are
    not; this is how long that is felt, averaged over the runs. The longest half run, where it never settles.
    """
    form = judged_form(dataset, metric, predictor.fields)
    times: list[float] = []
    for measured in dataset.runs.values():
        run = measured.telemetry
        middle = len(run.time_s) // 2
        late = Run(run.name, run.time_s[middle:], run.temperatures[middle:], run.channels[middle:])
        if len(late.time_s) < 2:
            continue
        whole = predictor.follow(run)
        gap = _size(predictor.follow(late) - whole[middle:], form)
        drift = _size(whole - whole[0], form).max()
        felt = np.flatnonzero(gap > HARDLY * drift)
        last = min(int(felt[-1]) + 1, len(late.time_s) - 1) if len(felt) else 0
        times.append(float(late.time_s[last] - late.time_s[0]))
    return float(np.mean(times)) if times else 0.0


def _size(coefficients: Array, form: Array) -> Array:
    """Return the tip's root mean square over the volume [µm], shape (T,)."""
    size: Array = np.sqrt(np.maximum(((coefficients @ form) * coefficients).sum(axis=1), 0.0))
    return size
