"""Choose the prior's sizes and the penalty for a machine: by what is left of runs that were left out whole.

Machines differ in what their sensors tell, so no single set of sizes is best for all. The modes are run once; the
features of any other sizes follow from them by a matrix that mixes the sensors, of which there are few, and by a
factor each. So do the normal equations, and all candidates of the grid take seconds.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.fields import Fields
from model.network import Prior, ThermalNetwork
from model.progress import Reporter
from model.sensors import SensorModel
from model.transforms import Array
from training.checkpoint import Stored
from training.coverage import by_pattern
from training.dataset import DataSet
from training.decoder import Normal
from training.effects import judged_form
from training.sample_folds import sample_folds
from training.samples import Samples, collect, input_scale
from training.split import Split
from training.tip import TipMetric
from training.trainer import Settings

LEAST_RUNS = 5
"""Runs from which on leaving some out says something of new ones. Parts of a single run do not: chosen by the spindle
phases of `etve`, the candidates did worse on other phases than the defaults."""
RIDGES = (0.1, 0.03, 0.01)
TAU_EXPONENTS = (-0.4, -0.2, 0.0, 0.2)
SOURCES = (4.0, 8.0, 16.0)
INSTANTS = (0.3, 1.0)
COMMONS = (0.0, 0.9)


@dataclass(frozen=True)
class Choice:
    """What was chosen.

    Attributes
    ----------
    settings : to train with
    left_before, left : share of the tip's drift that the linear decoder leaves of the left-out runs with the settings
        given, and with the chosen ones; None where there was nothing to choose by
    """

    settings: Settings
    left_before: float | None = None
    left: float | None = None

    def stored(self) -> Stored:
        """Return it for a checkpoint."""
        return Stored(rest=asdict(self))

    @classmethod
    def restored(cls, stored: Stored) -> Choice:
        """Return what `stored` keeps."""
        settings = dict(stored.rest["settings"])
        sizes: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in settings.pop("prior").items()}
        return cls(Settings(prior=Prior(**sizes), **settings), stored.rest["left_before"], stored.rest["left"])


def choose(dataset: DataSet, split: Split, metric: TipMetric, sensor_model: SensorModel, settings: Settings) -> Choice:
    """Return the settings with the prior's sizes and the penalty that leave the least of left-out runs.

    The settings stay as they are where there are fewer than `LEAST_RUNS` runs, or where the tip was measured instead
    of the error terms.
    """
    if len(split.train_runs) < LEAST_RUNS:
        return Choice(settings)
    fields = Fields(dataset.machine, dataset.terms, settings.degree)
    plain = replace(settings.prior, source=1.0, instant=1.0, tau_exponent=0.0, common=0.0)
    scale = input_scale(dataset, split.train_runs, sensor_model)
    net = ThermalNetwork(scale, plain, fields.size)
    samples = collect(net, dataset, split.train, metric.coverage, fields, sensor_model)
    if samples.information is not None:
        return Choice(settings)
    candidates = [settings, *_candidates(settings)]
    sizes = {c.prior: _sizes(net, ThermalNetwork(scale, c.prior, fields.size)) for c in candidates}
    mixed: dict[float, tuple[Samples, list[int]]] = {}  # candidates that mix the sensors alike
    for i, c in enumerate(candidates):
        if c.prior.common not in mixed:
            mixed[c.prior.common] = replace(samples, features=samples.features @ sizes[c.prior][0]), []
        mixed[c.prior.common][1].append(i)
    form = judged_form(dataset, metric, fields)
    left = np.zeros(len(candidates))
    drift = 0.0
    folds = sample_folds(samples, settings.folds)
    with Reporter("choosing the prior", len(folds)) as reporter:
        for inside in folds:
            for part, members in mixed.values():
                normal = Normal.of(part.where(inside), settings.correlation_s, bias=dataset.datum == "absolute")
                out = _LeftOut.of(part.where(~inside), form)
                for i in members:
                    c = candidates[i]
                    left[i] += out.left(*normal.solve(c.ridge, sizes[c.prior][1]))
            drift += out.square
            reporter.advance(f"{len(candidates)} candidates")
    if drift == 0.0:
        return Choice(settings)
    best = int(np.argmin(left))
    before, after = np.sqrt(np.maximum(left[[0, best]], 0.0) / drift)
    return Choice(candidates[best], float(before), float(after))


def _candidates(settings: Settings) -> Iterator[Settings]:
    grid = itertools.product(TAU_EXPONENTS, SOURCES, COMMONS, INSTANTS, RIDGES)
    for tau_exponent, source, common, instant, ridge in grid:
        prior = replace(settings.prior, tau_exponent=tau_exponent, source=source, common=common, instant=instant)
        yield replace(settings, prior=prior, ridge=ridge)


def _sizes(plain: ThermalNetwork, net: ThermalNetwork) -> tuple[Array, Array]:
    """Return M, shape (F, F), and s, shape (F,): a network's features from those of one with another prior, (f M) s."""
    width, lags = net.size.shape
    mix = np.eye(width)
    sensors = len(net.centre)
    mix[:sensors, :sensors] = np.linalg.solve(plain.mix.numpy(), net.mix.numpy())
    mixing = np.asarray(np.kron(mix, np.eye(lags)), dtype=float)
    scale = np.asarray((net.size / plain.size).numpy().reshape(-1), dtype=float)
    return mixing, scale


@dataclass(frozen=True)
class _LeftOut:
    """Left-out samples, in as few rows as say what any linear decoder leaves of them.

    Attributes
    ----------
    features, targets, known : shape (n, F + 1), (n, P), and which of the targets were measured
    form : shape (P, P)
    """

    features: Array
    targets: Array
    known: NDArray[np.bool_]
    form: Array

    @classmethod
    def of(cls, samples: Samples, form: Array) -> _LeftOut:
        constant = np.ones((len(samples.features), 1))
        whole = np.concatenate([samples.features, constant, np.nan_to_num(samples.targets)], axis=1)
        rows, known = [whole[:0]], [np.zeros((0, len(form)), dtype=bool)]
        for columns, which in by_pattern(np.isfinite(samples.targets)):
            part = whole[which]
            if len(part) > part.shape[1]:  # R of QR has the same sums of products
                part = np.asarray(np.linalg.qr(part, mode="r"))
            rows.append(part)
            known.append(np.tile(columns, (len(part), 1)))
        stacked = np.concatenate(rows)
        width = samples.features.shape[1] + 1
        return cls(stacked[:, :width], stacked[:, width:], np.concatenate(known), form)

    @property
    def square(self) -> float:
        """The summed mean squares at the tip of the drift itself."""
        return self._sum(self.targets)

    def left(self, weights: Array, bias: Array) -> float:
        """Return the summed mean squares at the tip that weights (F, P) and bias (P,) leave."""
        return self._sum(self.targets - self.features @ np.concatenate([weights, bias[None]]))

    def _sum(self, coefficients: Array) -> float:
        shown = np.where(self.known, coefficients, 0.0)
        return float(((shown @ self.form) * shown).sum())
