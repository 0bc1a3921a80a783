"""How far the network's predictions may be off, learned from parts of the training data that were left out in turn.

The linear decoder is fitted without each part and judged on it. Where the leverage of the thermal state is large,
which is where training saw few states like it, more is left; a line through the squares of what is left says how much.
What is left is correlated over hours, so thousands of measurements of a few runs say little about how the next run
will be: the interval is widened as Student's t says for as many parts as there are.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.stats import t as student

from model.fields import Fields
from model.manifest import UncertaintyRecord
from model.network import ThermalNetwork
from model.sensors import SensorModel
from model.tip_effects import tip_effects
from model.transforms import Array
from model.uncertainty import NORMAL_95, Uncertainty
from training.baselines.parts import grouped, parts
from training.coverage import by_pattern
from training.dataset import DataSet
from training.decoder import Whitening
from training.effects import judged_form
from training.samples import Samples, collect
from training.split import Split
from training.tip import TipMetric, tip_metric
from training.tip_methods import identify, measured_as
from training.volume import scattered_points

FOLDS, TIP_FOLDS = 8, 4
"""Times that parts are left out, at most (chosen: more takes longer); the second where the tip was measured, since each
fit then takes seconds."""
LEAST = 0.02
"""Least share of the mean variance that is left where the thermal state is as at rest (chosen)."""
FAINT = 1e-3
"""Share of the coefficients' variance below which a direction is dropped: it takes no more from any one (chosen)."""
POINTS = 64
"""Points of the working volume at which intervals are calibrated (chosen)."""
ROUNDS = 30
"""Of reweighting the line; it settles within ten."""
DIGITS = 7
"""That are written of each number: the manifest is text, and the leverage a difference of large numbers."""

Solve = Callable[[Samples], tuple[Array, Array]]
"""Fits the linear decoder: weights (F, P) and bias (P,)."""


def estimate(
    dataset: DataSet,
    split: Split,
    metric: TipMetric,
    net: ThermalNetwork,
    fields: Fields,
    sensor_model: SensorModel,
    solve: Solve,
    *,
    ridge: float,
    correlation_s: float,
) -> UncertaintyRecord | None:
    """Return how far a network may be off that was trained on the training part of a split.

    Where the tip was measured, it is judged by the terms that are identified from it.

    Parameters
    ----------
    ridge : added to the scaled modes' mean square in the leverage, as it is when the decoder is fitted
    correlation_s : time over which what is left is correlated, for the number of independent measurements [s]

    Returns
    -------
    None where the training part cannot be divided, or nothing is left of it
    """
    numbers = parts(dataset, split)
    part = np.concatenate([n[n >= 0] for n in numbers.values()])
    out = grouped(part, TIP_FOLDS if dataset.places else FOLDS)
    if not out:
        return None
    samples = collect(net, dataset, split.train, metric.coverage, fields, sensor_model)
    truth = samples.targets
    if dataset.places:
        terms = identify(dataset, metric, fields)
        truth = collect(net, terms, split.train, tip_metric(terms).coverage, fields, sensor_model).targets
    left, leverage = np.full_like(truth, np.nan), np.zeros(len(truth))
    for rows in out:
        inside = samples.where(~rows)
        weights, bias = solve(inside)
        left[rows] = truth[rows] - samples.features[rows] @ weights - bias
        z = scaled_modes(net, samples.features[rows])
        leverage[rows] = _beyond(z, _seen(scaled_modes(net, inside.features), ridge))
    shown = np.isfinite(left).any(axis=1)
    left, leverage, part = left[shown], leverage[shown], part[shown]
    form = judged_form(dataset, metric, fields)
    covariance = _covariance(left)
    expected = _expected(np.isfinite(left), covariance, form)
    known = np.nan_to_num(left)
    square = np.maximum(((known @ form) * known).sum(axis=1), 0.0)
    judged = expected > 0.0
    if not square[judged].any():
        return None
    independent = Whitening.of(samples, correlation_s).effective
    floor, rise = fit_line(leverage[judged], square[judged] / expected[judged])
    # Even where what was left out shows no rise, weights found from so many measurements have a variance of their own.
    rise = max(rise, floor / (ridge * independent))
    size = np.sqrt(floor + rise * leverage)
    directions = _directions(_covariance(left / size[:, None]))
    effects = tip_effects(fields, scattered_points(fields.machine)[:POINTS]).reshape(-1, fields.size)
    quantile = float(np.quantile(_ratios(left, size, directions, effects), 0.95))
    count = len(np.unique(part))
    names = split.train_runs
    what = f"{count} runs" if len(names) > 1 else f"{count} parts of run {names[0]}"
    seen = _seen(scaled_modes(net, samples.features), ridge)
    return UncertaintyRecord(
        directions=_written(directions),
        mode_size=_written(net.size[:, 1:].reshape(-1).numpy()),
        seen_directions=_written(seen),
        floor=floor,
        rise=rise,
        misfit_um=_misfit_um(dataset, split, metric, fields, truth),
        scale=quantile / NORMAL_95 * widening(count),
        quantile=quantile,
        parts=count,
        independent=independent,
        data=f"{what}, left out in turn",
        largest_size=float(size.max()),
    )


def _misfit_um(dataset: DataSet, split: Split, metric: TipMetric, fields: Fields, truth: Array) -> float:
    """Return what the series leave of the measurements that their coefficients (N, P) come from, per axis of the tip.

    Such as curves between the positions, or the noise of a probe.
    """
    squares, first = [np.zeros(0)], 0
    for name, mask in split.train.items():
        if not mask.any():
            continue
        run = dataset.runs[name]
        coefficients = np.full((len(mask), fields.size), np.nan)
        coefficients[mask] = truth[first : first + int(mask.sum())]
        first += int(mask.sum())
        shown = measured_as(dataset, metric, fields, run, np.nan_to_num(coefficients))
        squares.append(metric.mean_square((metric.sample(run.values) - shown)[mask]))
    return float(np.sqrt(np.concatenate(squares).mean() / 3.0))


def widening(count: int) -> float:
    """Return by how much an interval is wider whose size was found from `count` independent parts.

    Student's t of one part less stands for the normal distribution, as for the mean of so many normal numbers.
    """
    return float(student.ppf(0.975, max(count - 1, 1))) / NORMAL_95


def fit_line(leverage: Array, square: Array) -> tuple[float, float]:
    """Return floor and rise of the expected squares over the leverage, neither negative.

    Squares of normal numbers scatter in proportion to their mean, so each is weighted by the square of what the last
    round expected there: the maximum of the likelihood of a gamma distribution.
    """
    design = np.stack([np.ones_like(leverage), leverage / (leverage.mean() or 1.0)], axis=1)
    mean = float(square.mean())
    expected = np.full(len(square), mean)
    found = np.array([mean, 0.0])
    for _ in range(ROUNDS):
        found = nnls(design / expected[:, None], square / expected)[0]
        found[0] = max(found[0], LEAST * mean)
        expected = design @ found
    return float(found[0]), float(found[1] / (leverage.mean() or 1.0))


def scaled_modes(net: ThermalNetwork, features: Array) -> Array:
    """Return the part of the features (N, F) that are modes, scaled by the prior, shape (N, M)."""
    drives, width = net.size.shape
    modes: Array = features.reshape(len(features), drives, width)[:, :, 1:].reshape(len(features), -1)
    return modes


def spread(uncertainty: Uncertainty, net: ThermalNetwork, features: Array) -> Array:
    """Return s at features (N, F), for networks that are not in a bundle."""
    return uncertainty.size_of(scaled_modes(net, features))


def _seen(z: Array, ridge: float) -> Array:
    """Return S, shape (L, M): the leverage of z (N, M), times the ridge, is |z|² - |S z|².

    With Z'Z/n = U Λ U', (Z'Z/n + r)⁻¹ = (1 - U Λ/(Λ + r) U') / r.
    """
    values, vectors = np.linalg.eigh(z.T @ z / len(z))
    share = np.maximum(values, 0.0) / (np.maximum(values, 0.0) + ridge)
    kept = share > 0.01  # directions seen less count as not seen
    found: Array = (vectors[:, kept] * np.sqrt(share[kept])).T
    return found


def _beyond(z: Array, seen: Array) -> Array:
    """Return the leverage times the ridge, shape (N,)."""
    found: Array = np.maximum((z**2).sum(axis=1) - ((z @ seen.T) ** 2).sum(axis=1), 0.0)
    return found


def _covariance(left: Array) -> Array:
    """Return the second moments (P, P) of what is left (N, P); each pair counts the times that know both."""
    there = np.isfinite(left).astype(float)
    known = np.nan_to_num(left)
    found: Array = known.T @ known / np.maximum(there.T @ there, 1.0)
    return found


def _expected(known: NDArray[np.bool_], covariance: Array, form: Array) -> Array:
    """Return the tip's mean square (N,) that rows which know some coefficients (N, P) show on average."""
    weighted = covariance * form
    found: Array = ((known @ weighted) * known).sum(axis=1)
    return np.maximum(found, 0.0)


def _directions(covariance: Array) -> Array:
    """Return directions d, shape (R, P), with Σ d d' close to the covariance (P, P)."""
    deviation = np.sqrt(np.diag(covariance))
    unit = np.where(deviation > 0.0, deviation, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    kept = values > FAINT
    found: Array = (vectors[:, kept] * np.sqrt(values[kept])).T * deviation
    return found[::-1]


def _ratios(left: Array, size: Array, directions: Array, effects: Array) -> Array:
    """Return |residual| / standard deviation at the tip, shape (any,), over rows, points and axes.

    `effects` (n, P) move the tip; of rows that know some coefficients, both are of these.
    """
    found = [np.zeros(0)]
    for pattern, rows in by_pattern(np.isfinite(left)):
        some = effects[:, pattern]
        usual = np.sqrt(((some @ directions[:, pattern].T) ** 2).sum(axis=1))
        seen = usual > 1e-9 * usual.max()
        off = np.abs(left[np.ix_(rows, np.flatnonzero(pattern))] @ some[seen].T)
        found.append((off / (size[rows, None] * usual[seen])).ravel())
    return np.concatenate(found)


def _written(values: Array) -> list[list[float]]:
    rounded: list[list[float]] = np.vectorize(lambda v: float(f"{v:.{DIGITS}g}"), otypes=[float])(values).tolist()
    return rounded
