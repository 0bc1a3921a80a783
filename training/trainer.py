"""Train the thermal network on the measurements of a data set: error terms, tool-tip deviations, or both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from model.exceptions import ComputeError
from model.fields import Fields
from model.network import InputScale, Prior, Residual, ThermalNetwork
from model.progress import Reporter
from model.sensors import SensorModel
from model.transforms import Array
from training.dataset import DataSet
from training.decoder import solve_decoder
from training.earlier import PULLS, Earlier
from training.effects import judged_form
from training.residual import fit_residual
from training.sample_folds import sample_folds
from training.samples import Samples, collect, input_scale
from training.split import Split
from training.tip import TipMetric


@dataclass(frozen=True)
class Settings:
    """How to train (docs/network.md says how the defaults were found, `choice.py` what is chosen for each machine).

    Attributes
    ----------
    prior : sizes and time constants of the modes
    degree : of the motion terms' Chebyshev series
    ridge : of the linear decoder, penalty of a squared weight beside the mean square that an independent measurement
        leaves; it does not fade as measurements add up (see `decoder.solve_decoder`)
    correlation_s : time over which the decoder's residual is taken to be correlated [s]
    hidden, steps, learning_rate, weight_decay : of the nonlinear residual
    folds : parts that the training data is cut into to find out whether the residual helps
    seed : of the residual's first weights
    """

    prior: Prior = field(default_factory=Prior)
    degree: int = 3
    ridge: float = 0.05
    correlation_s: float = 900.0
    hidden: int = 16
    steps: int = 300
    learning_rate: float = 3e-3
    weight_decay: float = 0.1
    folds: int = 5
    seed: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Return it for the manifest."""
        return asdict(self)


@dataclass(frozen=True)
class Verdict:
    """Whether the nonlinear residual earns its place.

    Attributes
    ----------
    keep : whether it does
    left_linear, left_whole : share of the tip's drift that the linear decoder, and the decoder with the residual,
        leave on parts of the training data that they were not fitted to
    """

    keep: bool
    left_linear: float
    left_whole: float


@dataclass(frozen=True)
class Training:
    """A trained network.

    Attributes
    ----------
    solve : fits the linear decoder to other samples as to these, weights (F, P) and bias (P,)
    curves : of each fit of the residual, its loss step by step (see `residual.fit_residual`): the folds' first, then
        that of the residual in the network, where it was kept
    pull : how strongly the weights were pulled towards those of an earlier network, None where there was none or
        where it did not help
    """

    net: ThermalNetwork
    fields: Fields
    verdict: Verdict
    scale: InputScale
    solve: Callable[[Samples], tuple[Array, Array]]
    curves: list[list[float]] = field(default_factory=list)
    pull: float | None = None


def train_network(
    dataset: DataSet,
    split: Split,
    metric: TipMetric,
    sensor_model: SensorModel,
    settings: Settings,
    verdict: Verdict | None = None,
    earlier: Earlier | None = None,
) -> Training:
    """Return a network trained on the training part of a split; one seed gives one network.

    `verdict` is that of an earlier training on part of the same data; without it, folds of the data decide whether
    the residual is kept. `earlier` is a network to start from, where that helps on folds.

    Raises
    ------
    DataError
        where the training part never shows one of the terms.
    ComputeError
        where the decoder is not finite.
    """
    fields = Fields(dataset.machine, dataset.terms, settings.degree)
    scale = input_scale(dataset, split.train_runs, sensor_model) if earlier is None else earlier.scale
    net = ThermalNetwork(scale, settings.prior if earlier is None else earlier.prior, fields.size)
    samples = collect(net, dataset, split.train, metric.coverage, fields, sensor_model)
    decoder = _Decoder(settings, judged_form(dataset, metric, fields), bias=dataset.datum == "absolute")
    shown = bool(np.isfinite(samples.targets).all(axis=1).any())  # the residual learns from times that show all terms
    folds = sample_folds(samples, settings.folds) if verdict is None and shown else []
    if earlier is not None:
        decoder.start_from(earlier, samples, sample_folds(samples, settings.folds))
    with Reporter("training", settings.steps * (len(folds) + 1)) as reporter:
        if verdict is None:
            verdict = decoder.verdict(samples, folds, reporter)
        linear, bias, residual = decoder.fit(samples, reporter, residual=verdict.keep)
    if not (np.isfinite(linear).all() and np.isfinite(bias).all()):
        raise ComputeError("the decoder must be finite; look for extreme values in the data set")
    with torch.no_grad():
        net.linear.copy_(torch.tensor(linear))
        net.bias.copy_(torch.tensor(bias))
    net.residual = residual
    return Training(net, fields, verdict, scale, decoder.linear, [c for c in decoder.curves if c], decoder.pull)


class _Decoder:
    """Fits linear decoder and residual, and judges them on left-out samples."""

    def __init__(self, settings: Settings, form: Array, *, bias: bool) -> None:
        self._settings, self._form, self._bias = settings, form, bias
        self.curves: list[list[float]] = []
        self._earlier: Earlier | None = None
        self.pull: float | None = None

    def start_from(self, earlier: Earlier, samples: Samples, folds: list[NDArray[np.bool_]]) -> None:
        """Choose how strongly the weights are pulled towards earlier ones, or not at all, by what folds leave.

        Without folds, as of a single stretch, the weakest pull is taken: the data has the last word.
        """
        self._earlier = earlier
        left: dict[float | None, float] = {None: 0.0, **dict.fromkeys(PULLS, 0.0)}
        for self.pull in left:
            for inside in folds:
                linear, bias = self.linear(samples.where(inside))
                out = samples.where(~inside)
                left[self.pull] += self._left(out, linear, bias)
        self.pull = min(left, key=lambda pull: left[pull]) if folds else PULLS[0]

    def _left(self, samples: Samples, linear: Array, bias: Array) -> float:
        """Return what the linear decoder leaves at the tip, in squares; where only the tip was measured, of that."""
        rest = samples.less(linear, bias)
        if rest.information is None:
            return self._square(rest.targets)
        return float((rest.information.vector**2).sum())

    def linear(self, samples: Samples) -> tuple[Array, Array]:
        """Return the linear decoder's weights and bias."""
        s = self._settings
        if self._earlier is None or self.pull is None:
            return solve_decoder(samples, ridge=s.ridge, correlation_s=s.correlation_s, bias=self._bias)
        linear, bias = self._earlier.weights, self._earlier.bias * self._bias
        rest = samples.less(linear, bias)
        more, shift = solve_decoder(rest, ridge=s.ridge * self.pull, correlation_s=s.correlation_s, bias=self._bias)
        return linear + more, bias + shift

    def fit(self, samples: Samples, reporter: Reporter, *, residual: bool) -> tuple[Array, Array, Residual | None]:
        """Return the linear decoder's weights and bias, and the residual, if it is wanted."""
        s = self._settings
        linear, bias = self.linear(samples)
        if not residual:
            return linear, bias, None
        self.curves.append([])
        fitted = fit_residual(
            samples,
            linear,
            bias,
            self._form,
            hidden=s.hidden,
            steps=s.steps,
            learning_rate=s.learning_rate,
            weight_decay=s.weight_decay,
            correlation_s=s.correlation_s,
            seed=s.seed,
            reporter=reporter,
            curve=self.curves[-1],
        )
        return linear, bias, fitted

    def verdict(self, samples: Samples, folds: list[NDArray[np.bool_]], reporter: Reporter) -> Verdict:
        """Return whether the residual lowers what is left on the folds."""
        squares = [self._judge(samples.where(f), samples.where(~f), reporter) for f in folds]
        base, left_linear, left_whole = np.sqrt(np.sum(squares, axis=0)) if squares else (0.0, 0.0, 0.0)
        if base == 0.0:
            return Verdict(keep=False, left_linear=0.0, left_whole=0.0)
        return Verdict(bool(left_whole < left_linear), float(left_linear / base), float(left_whole / base))

    def _judge(self, inside: Samples, outside: Samples, reporter: Reporter) -> tuple[float, float, float]:
        """Return the summed mean squares at the tip: of the drift, left by the linear decoder, left by the whole."""
        linear, bias, residual = self.fit(inside, reporter, residual=True)
        left = outside.targets - outside.features @ linear - bias
        return self._square(outside.targets), self._square(left), self._square(left - _added(residual, outside))

    def _square(self, coefficients: Array) -> float:
        known = np.nan_to_num(coefficients)
        return float(((known @ self._form) * known).sum())


def _added(residual: Residual | None, samples: Samples) -> Array:
    if residual is None:
        return np.zeros_like(samples.targets)
    with torch.no_grad():
        added: Array = residual(torch.tensor(samples.features + samples.first)).numpy()
        if np.any(samples.first):
            added = added - residual(torch.tensor(samples.first)).numpy()
    return added
