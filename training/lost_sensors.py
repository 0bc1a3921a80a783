"""What the values and modes of a lost sensor are told by, learned from the training data alone.

The joint second moments of all sensors' values and modes and of the sources' modes, in few factors. Parts of the
training data are left out in turn: what the estimates leave there says how long it lasts, and by how much more they
miss than their own covariance says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.fields import Fields
from model.lost_sensors import SOURCE, LostSensors
from model.manifest import LostSensorRecord
from model.network import ThermalNetwork
from model.sensors import SensorModel
from model.tip_effects import tip_form
from model.transforms import Array
from training.baselines.parts import grouped, parts
from training.dataset import DataSet
from training.samples import Samples, collect
from training.split import Split
from training.tip import TipMetric
from training.uncertainty import FOLDS, widening

NOISE = 0.05
"""Variance that each feature shares with no other, beside a typical swing's or, of a source's, half its full load
(chosen: bench/lost_sensor.py; between 0.02 and 0.1 little changes)."""
FAINT = 0.05
"""Share of the noise below which a factor is dropped (chosen: it tells a twentieth of what noise hides)."""
LAG_S = 3600.0
"""Over which it is measured how what the estimates miss lasts [s] (chosen)."""
LONGEST_S = 864000.0
"""Memory of what lasts throughout [s] (chosen: ten days)."""
DIGITS = 6


@dataclass(frozen=True)
class Layout:
    """The features of a data set's training part.

    Attributes
    ----------
    rows : shape (N, F), sensors' in °C, of run-start data less those at the run's start
    run, time_s, part : of each row, shape (N,); part -1 belongs to none
    sensors, sources : S and Q
    """

    rows: Array
    run: NDArray[np.intp]
    time_s: Array
    part: NDArray[np.intp]
    sensors: int
    sources: int


def learn_lost_sensors(
    dataset: DataSet,
    split: Split,
    metric: TipMetric,
    net: ThermalNetwork,
    fields: Fields,
    sensor_model: SensorModel,
) -> LostSensorRecord:
    """Return how lost sensors are told, and how far to rely on it, for a network trained on a split's training part."""
    samples = collect(net, dataset, split.train, metric.coverage, fields, sensor_model)
    numbers = parts(dataset, split)
    part = np.concatenate([n[mask] for n, mask in ((numbers[name], split.train[name]) for name in numbers)])
    layout = _layout(net, samples, part, absolute=dataset.datum == "absolute")
    form, effects = tip_form(fields), _effects(net)
    weights, bias = net.linear.detach().numpy(), net.bias.detach().numpy()
    said = samples.features @ weights + (bias if dataset.datum == "absolute" else 0.0)
    drift_um = float(np.sqrt(((said @ form) * said).sum(axis=1).mean()))
    tau_s = net.tau_s.numpy()
    everything = np.ones(len(layout.rows), dtype=bool)
    whole = _fit(layout, everything, tau_s, absolute=dataset.datum == "absolute")
    missed, expected, again, against = 0.0, 0.0, np.zeros(len(tau_s) + 1), np.zeros(len(tau_s) + 1)
    left_out = grouped(part, FOLDS)
    for out in left_out or [everything]:
        record = _fit(layout, ~out if left_out else out, tau_s, absolute=dataset.datum == "absolute")
        told = LostSensors(record, layout.sensors, layout.sources, tau_s)
        scaled = _scaled(layout.rows[out], record, layout)
        at = effects * record.swing_K
        for sensor in range(layout.sensors):
            missing = np.arange(layout.sensors) == sensor
            given = told.given(missing)
            off = scaled[:, given.lost] - scaled[:, ~given.lost] @ given.gain
            moved, roots = off @ at[sensor], given.roots @ at[sensor]
            missed += float(((moved @ form) * moved).sum())
            expected += len(off) * float(((roots @ form) * roots).sum())
            first, later = _pairs(layout.run[out], layout.time_s[out])
            again += (off[first] * off[later]).sum(axis=0)
            against += (off[first] ** 2).sum(axis=0)
    lasting = np.clip(again / np.where(against > 0.0, against, 1.0), 1e-6, np.exp(-LAG_S / LONGEST_S))
    # What a mode misses cannot fade faster than the mode.
    memory_s = np.maximum(-LAG_S / np.log(lasting), np.concatenate([[60.0], tau_s]))
    ratio = np.sqrt(missed / expected) if expected > 0.0 and missed > 0.0 else 1.0
    # Below 1 where the others tell each sensor well; that says little of several that are lost together.
    scale = max(float(ratio), 1.0) * widening(len(np.unique(part[part >= 0])))
    found = {"memory_s": [float(m) for m in memory_s], "scale": scale, "drift_um": drift_um}
    return whole.model_copy(update=found)


def _layout(net: ThermalNetwork, samples: Samples, part: NDArray[np.intp], *, absolute: bool) -> Layout:
    drives, width = net.size.shape
    sensors = len(net.centre)
    shaped = (samples.features / net.size.reshape(-1).numpy()).reshape(-1, drives, width)
    degC = np.einsum("nik,ij->njk", shaped[:, :sensors], np.linalg.inv(net.mix.numpy()))
    if absolute:
        degC = degC + net.centre.numpy()[:, None]
    rows = np.concatenate([degC.reshape(len(shaped), -1), shaped[:, sensors:, 1:].reshape(len(shaped), -1)], axis=1)
    return Layout(rows, samples.run, samples.time_s, part, sensors, drives - sensors)


def _fit(layout: Layout, rows: NDArray[np.bool_], tau_s: Array, *, absolute: bool) -> LostSensorRecord:
    """Return the second moments of some rows; its memory, scale and the rest are still to be found."""
    chosen = layout.rows[rows]
    own = layout.sensors * (len(tau_s) + 1)
    mean = chosen.mean(axis=0) if absolute else np.zeros(chosen.shape[1])
    values = chosen[:, : own : len(tau_s) + 1]
    swing_K = float(np.sqrt(((values - values.mean(axis=0)) ** 2).mean())) or 1.0
    record = LostSensorRecord(
        mean=_written(mean[None])[0],
        swing_K=swing_K,
        factors=[],
        noise=NOISE,
        memory_s=[60.0, *tau_s.tolist()],
        scale=1.0,
        drift_um=0.0,
    )
    scaled = _scaled(chosen, record, layout)
    found, vectors = np.linalg.eigh(scaled.T @ scaled / len(scaled))
    kept = found > FAINT * NOISE
    factors = (vectors[:, kept] * np.sqrt(found[kept])).T
    return record.model_copy(update={"factors": _written(factors if kept.any() else np.zeros((1, len(found))))})


def _scaled(rows: Array, record: LostSensorRecord, layout: Layout) -> Array:
    own = rows.shape[1] - layout.sources * (len(record.memory_s) - 1)
    centred = rows - np.array(record.mean)
    return np.concatenate([centred[:, :own] / record.swing_K, SOURCE * centred[:, own:]], axis=1)


def _effects(net: ThermalNetwork) -> Array:
    """Return the linear decoder's effect of 1 K of each sensor's value and modes, shape (S, 1 + K, P)."""
    drives, width = net.size.shape
    sensors = len(net.centre)
    weights = net.linear.detach().numpy().reshape(drives, width, -1) * net.size.numpy()[:, :, None]
    found: Array = np.einsum("ji,ikp->jkp", net.mix.numpy(), weights[:sensors])
    return found


def _pairs(run: NDArray[np.intp], time_s: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and those about `LAG_S` later in the same run."""
    first, later = [], []
    for number in np.unique(run):
        rows = np.flatnonzero(run == number)
        at = np.searchsorted(time_s[rows], time_s[rows] + LAG_S)
        there = at < len(rows)
        close = there & (time_s[rows[np.minimum(at, len(rows) - 1)]] - time_s[rows] < 1.5 * LAG_S)
        first.append(rows[close])
        later.append(rows[at[close]])
    return np.concatenate(first), np.concatenate(later)


def _written(values: Array) -> list[list[float]]:
    rounded: list[list[float]] = np.vectorize(lambda v: float(f"{v:.{DIGITS}g}"), otypes=[float])(values).tolist()
    return rounded
