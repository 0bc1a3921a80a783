"""What each method says of the left-out runs: computed once, for tables, figures and the worst moments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.machine import Machine
from model.transforms import Array
from model.uncertainty import NORMAL_95
from training.dataset import MeasuredRun
from training.evaluation import NETWORK, NO_COMPENSATION, scored_rows
from training.interval import network_spread
from training.job import Result
from training.report.units import plain
from training.split import Mask
from training.tip import TipMetric


@dataclass(frozen=True)
class LeftOutRun:
    """A run with left-out measurements.

    Attributes
    ----------
    left_out : which measurements were left out, shape (N,)
    scored : which of these are scored, shape (N,)
    truth : what was measured as the metric has it, terms on their grids and the tip, shape (N, G) [µm, µrad]; NaN
        where it was not
    said : by method, what it predicts of them, shape (N, G); nought for no compensation
    rms_um : by method, the residual's root mean square over the volume, shape (N,); NaN where a time shows less than
        others do, since the sum of fewer terms is another quantity
    at_um : by method, the residual of the tip at one place, shape (N, 3); NaN as above
    at : that place, in words
    allowed_um : what the network's 95 % interval allows there to either side in x, y and z, shape (N, 3); None where
        the bundle does not say, or at many places at once
    alike : whether the times show the same; where each shows other terms, one cannot be joined to the next
    """

    name: str
    measured: MeasuredRun
    left_out: Mask
    scored: Mask
    truth: Array
    said: dict[str, Array]
    rms_um: dict[str, Array]
    at_um: dict[str, Array]
    at: str
    alike: bool
    allowed_um: Array | None = None

    @property
    def hours(self) -> Array:
        """Times of measurement since power-on, shape (N,) [h]."""
        return self.measured.time_s / 3600.0

    def worst_um(self, method: str) -> float:
        """Return the largest residual of the left-out part."""
        left = self.rms_um[method][self.scored]
        return float(np.nanmax(left)) if np.isfinite(left).any() else 0.0


def best_baseline(result: Result) -> str | None:
    """Return the baseline that leaves least, if any was fitted."""
    names = [n for n in result.scores if n not in {NETWORK, NO_COMPENSATION}]
    return min(names, key=lambda n: result.scores[n].rms_um) if names else None


def left_out_runs(result: Result) -> list[LeftOutRun]:
    """Return the runs with left-out measurements that are scored, those that the network predicts worst first."""
    scored = scored_rows(result.dataset, result.tested, result.metric).masks
    runs = [_follow(result, name, mask) for name, mask in scored.items()]
    return sorted(runs, key=lambda run: -result.scores[NETWORK].by_run_um[run.name])


def _follow(result: Result, name: str, scored: Mask) -> LeftOutRun:
    run, metric = result.dataset.runs[name], result.metric
    truth = metric.sample(run.values)
    whole = metric.whole(truth)
    comparable = np.where(whole.any() & ~whole, np.nan, 1.0)
    said = {NO_COMPENSATION: np.zeros_like(truth)}
    said.update({method: predict(run) for method, predict in result.methods.items()})
    left = {method: truth - terms for method, terms in said.items()}
    place = _place(metric, run, truth)
    return LeftOutRun(
        name,
        run,
        result.tested[name],
        scored,
        truth,
        said,
        {m: np.sqrt(metric.mean_square(r)) * comparable for m, r in left.items()},
        {m: _tip_at(result, r, place) * comparable[:, None] for m, r in left.items()},
        _place_in_words(result, run, place),
        bool(whole.any()),
        _allowed(result, run, place),
    )


_MIDDLE, _EVERYWHERE = -1, -2


def _place(metric: TipMetric, run: MeasuredRun, truth: Array) -> int:
    """Return where the run's tip is shown: the middle of the volume, or one of the measured places.

    The middle, where terms say what happens there; else the place that was measured most often and at one position;
    everywhere, where the positions were drawn anew each time.
    """
    if run.places is None or not len(run.places):
        return _MIDDLE
    terms = metric.matrix.shape[2]
    if metric.complete and np.isfinite(truth[:, :terms]).all(axis=1).any():
        return _MIDDLE
    tip: Mask = np.asarray(np.isfinite(truth[:, terms:].reshape(len(truth), -1, 3)).all(axis=2))  # (N, m)
    there = np.where(tip[:, :, None], run.places, np.nan)
    fixed = np.array([_still(there[tip[:, p], p]) for p in range(there.shape[1])])
    often = np.where(fixed, tip.sum(axis=0), 0)
    return int(np.argmax(often)) if often.max() > 1 else _EVERYWHERE


def _still(positions: Array) -> bool:
    return bool(len(positions) and np.ptp(positions, axis=0).max() == 0.0)


def _tip_at(result: Result, left: Array, place: int) -> Array:
    metric = result.metric
    if place == _MIDDLE:
        return np.asarray(metric.deviation(left)[:, _middle(result)])
    tip = left[:, metric.matrix.shape[2] :].reshape(len(left), -1, 3)
    if place == _EVERYWHERE:
        known: Mask = np.asarray(np.isfinite(tip).all(axis=2))
        squares = np.where(known[:, :, None], tip**2, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)[:, None]
        some = known.sum(axis=1, keepdims=True) > 0
        return np.asarray(np.where(some, np.sqrt(squares), np.nan))
    return np.asarray(tip[:, place])


def _allowed(result: Result, run: MeasuredRun, place: int) -> Array | None:
    if result.making is None or result.making.predictor.uncertainty is None or place == _EVERYWHERE:
        return None
    predictor, uncertainty = result.making.predictor, result.making.predictor.uncertainty
    q = result.metric.positions[_middle(result)]
    if place != _MIDDLE and run.places is not None:
        q = run.places[np.isfinite(run.places[:, place]).all(axis=1)][0, place]
    size = network_spread(predictor, result.dataset)(run)
    usual = np.repeat(uncertainty.usual_tip(q[None]), len(size), axis=0)
    return NORMAL_95 * uncertainty.whole(usual, size)


def _middle(result: Result) -> int:
    """Return the sampled point nearest to the middle of the working volume."""
    machine = result.dataset.machine
    axes = [machine.axes[a] for a in machine.axis_names]
    span = np.array([a.high - a.low for a in axes])
    centre = np.array([(a.low + a.high) / 2 for a in axes])
    return int(np.argmin(np.linalg.norm((result.metric.positions - centre) / span, axis=1)))


def _place_in_words(result: Result, run: MeasuredRun, place: int) -> str:
    machine = result.dataset.machine
    if place == _MIDDLE:
        return f"at {position_text(machine, result.metric.positions[_middle(result)])}, near the middle of the volume"
    if place == _EVERYWHERE or run.places is None:
        return "as root mean square over the positions that were measured at a time"
    known = np.isfinite(run.places[:, place]).all(axis=1)
    return f"at {position_text(machine, run.places[known][0, place])}, where it was measured most often"


def position_text(machine: Machine, q: Array) -> str:
    """Return a position: "X 400 mm, Y 250 mm, B 30 degree"."""
    pairs = zip(machine.axis_names, q, strict=True)
    return ", ".join(f"{axis} {plain(round(float(v), 1))} {machine.axes[axis].unit}" for axis, v in pairs)
