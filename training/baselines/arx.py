"""Autoregressive models with external inputs (ARX), in free run.

The model of thermal adaptive learning control: Blaser, Pavliček, Mori, Mayr, Weikert and Wegener, "Adaptive learning
control for thermal error compensation of 5-axis machine tools", J. Manuf. Syst. 44 (2017) 302. Each error follows its
own past and the inputs:

    y(k) = Σ a_i y(k-i) + Σ b_j u(k-j)

Weights are fitted to measured pasts; settings are chosen by, and predictions made of, the model's own past alone.
Here the errors are the principal components of all terms at the tip.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from model.transforms import Array
from training.baselines.clocked import Clocked, clock, read, training_runs
from training.baselines.normal import Normal
from training.baselines.protocol import Task
from training.dataset import MeasuredRun

FINE_S = 300.0
"""The finest step [s], or the typical gap between measurements where that is longer (chosen)."""
STEPS = (1, 3, 6, 12)
"""Candidate steps, in fine ones: errors are smooth, and close steps leave the own past's weights to the noise."""
OWN = (1, 2)
"""Candidate numbers of own past values."""
INPUTS = (1, 2)
"""Candidate numbers of input values, the present one counted."""
PENALTIES = np.logspace(-6.0, 1.0, 8)
"""Candidate penalties of the inputs' weights, times the number of rows; own past values are not penalised."""
FOLDS = 5
"""Parts are left out in at most so many groups."""
SLOWEST = 0.999
"""Poles farther out than this are moved in, so that no free run diverges."""


@dataclass(frozen=True)
class Order:
    """Settings of an ARX model.

    Attributes
    ----------
    step : in fine steps
    own, inputs : past values of itself; present and past values of the inputs
    width : inputs, from the first
    """

    step: int
    own: int
    inputs: int
    width: int


@dataclass(frozen=True)
class ARX:
    """A model for each score.

    Attributes
    ----------
    fine_s : the fine step [s]
    weights : shape (R, own + inputs * width + 1): a, b by lag, and a constant
    """

    task: Task
    fine_s: float
    order: Order
    weights: Array
    settings: dict[str, Any]

    def predict(self, run: MeasuredRun) -> Array:
        """Return the terms of a run on the metric's grid, shape (N, G) [µm, µrad], its own past fed back."""
        time_s, drive = clock(self.task, run, self.fine_s * self.order.step)
        scores = np.stack([free_run(w, self.order, drive, self.task) for w in self.weights], axis=1)
        return self.task.components.grid(read(time_s, self.task.since_start(scores), run))


class ARXBaseline:
    """Orders, step, inputs and penalty are those whose free run predicts left-out parts best at the tip."""

    name = "ARX in free run"

    def fit(self, task: Task) -> ARX:
        """Learn from the training part."""
        gaps = [np.diff(run.time_s) for run in task.runs.values() if len(run.time_s) > 1]
        fine_s = max(FINE_S, float(np.median(np.concatenate(gaps))) if gaps else FINE_S)
        runs = training_runs(task, fine_s)
        known = np.unique(np.concatenate([run.part[run.part >= 0] for run in runs]))
        groups = [known[k::FOLDS] for k in range(min(FOLDS, len(known)))] if len(known) > 1 else []
        sensors, channels = task.inputs.sensors, task.inputs.channels
        widths = sorted({sensors, sensors + channels})
        best, found = np.inf, (Order(STEPS[1], OWN[0], INPUTS[0], widths[-1]), len(PENALTIES) // 2)
        for order in (Order(*o) for o in product(STEPS, OWN, INPUTS, widths)) if groups else ():
            errors = _free_run_errors(task, runs, order, groups)
            if errors.min() < best:
                best, found = float(errors.min()), (order, int(np.argmin(errors)))
        order, i = found
        weights = np.stack(
            [
                stable(_solve(_normal(task, runs, order, r, known), order, PENALTIES[[i]])[0], order.own)
                for r in range(task.components.count)
            ]
        )
        settings = {
            "step_s": fine_s * order.step,
            "own_past": order.own,
            "inputs_past": order.inputs - 1,
            "channels": order.width > sensors,
            "penalty": float(PENALTIES[i]),
        }
        return ARX(task, fine_s, order, weights, settings)


def free_run(weights: Array, order: Order, drive: Array, task: Task) -> Array:
    """Return one score (K,) over a run driven by (K, S + C) at the order's step, from the steady state of its start.

    In that state the temperatures have long been what they are, and the channels zero.
    """
    own, gain = weights[: order.own], weights[order.own : -1].reshape(order.inputs, order.width)
    before = np.where(np.arange(drive.shape[1]) < task.inputs.sensors, drive[0], 0.0)
    padded = np.concatenate([np.tile(before, (order.inputs, 1)), drive])[:, : order.width]
    pushed = sum((padded[order.inputs - j : len(padded) - j] @ gain[j] for j in range(order.inputs)), weights[-1])
    rest = before[: order.width] @ gain.sum(axis=0) + weights[-1]
    excess = np.asarray(pushed) - rest
    excess[0] = 0.0  # the first sample is the steady state itself
    scores: Array = lfilter([1.0], np.concatenate([[1.0], -own]), excess) + rest / (1.0 - own.sum())
    return scores


def stable(weights: Array, own: int) -> Array:
    """Return the weights with all poles moved inside, along their radius, if one is too far out."""
    poles = np.roots(np.concatenate([[1.0], -weights[:own]]))
    far = float(np.abs(poles).max())
    if far <= SLOWEST:
        return weights
    moved = weights.copy()
    moved[:own] *= (SLOWEST / far) ** np.arange(1, own + 1)
    return moved


def _free_run_errors(task: Task, runs: list[Clocked], order: Order, groups: list[NDArray[np.intp]]) -> Array:
    """Return the summed squares (len(PENALTIES),) of free runs in each group of parts, fitted to the others."""
    errors = np.zeros(len(PENALTIES))
    for r in range(task.components.count):
        each = [_normal(task, runs, order, r, group) for group in groups]
        whole = sum(each[1:], each[0])
        for part, group in zip(each, groups, strict=True):
            solved = _solve(whole - part, order, PENALTIES)
            for i, weights in enumerate(solved):
                steady = stable(weights, order.own)
                for run in runs:
                    judged = np.isin(run.part, group)[:: order.step]
                    if judged.any():
                        left = run.scores[:: order.step, r] - free_run(steady, order, run.drive[:: order.step], task)
                        errors[i] += float(np.nansum(left[judged] ** 2))
    return errors


def _normal(task: Task, runs: list[Clocked], order: Order, r: int, group: NDArray[np.intp]) -> Normal:
    """Return the normal equations of one score over the rows of some parts, whose past was measured."""
    width = order.own + order.inputs * order.width + 1
    total = Normal(np.zeros((width, width)), np.zeros((width, 1)), 0.0)
    for run in runs:
        y, u, s = run.scores[:, r], run.drive[:, : order.width], order.step
        k = np.flatnonzero(np.isin(run.part, group))
        k = k[k >= s * max(order.own, order.inputs - 1)]
        past = np.stack([y[k - s * i] for i in range(1, order.own + 1)], axis=1)
        x = np.concatenate([past, *(u[k - s * j] for j in range(order.inputs)), np.ones((len(k), 1))], axis=1)
        if not task.intercept:
            x[:, -1] = 0.0
        rows = np.isfinite(y[k]) & np.isfinite(past).all(axis=1)
        total = total + Normal.of(x[rows], y[k][rows, None])
    return total


def _solve(normal: Normal, order: Order, penalties: Array) -> Array:
    """Return the weights for each penalty, shape (len(penalties), width)."""
    width = len(normal.square)
    free = (np.arange(width) < order.own) | (np.arange(width) == width - 1)
    rows = max(float(normal.square[order.own :, order.own :].diagonal().max()), 1e-12)
    return normal.solve(rows * penalties, free)[:, :, 0]
