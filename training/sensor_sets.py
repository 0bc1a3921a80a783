"""What the network leaves on left-out data with only some of its inputs, fast enough to try thousands of sets.

An input's modes do not know of the other inputs, except that the network takes most of the common rise out of the
temperatures, which is linear. So the modes of every sensor and channel are run once, and the decoder of any set follows
in closed form from the normal equations of them all. It is the decoder that `train_network` finds on a data set that
has only these inputs, without the nonlinear residual. Ridge regression is linear in its targets, so the tip at places
that were measured again and again may stand for the coefficients that move it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from model.exceptions import DataError
from model.fields import Fields
from model.network import ThermalNetwork
from model.sensors import SensorModel
from model.transforms import Array
from training.dataset import DataSet
from training.decoder import BIAS_SIZE, Whitening
from training.evaluation import column_basis, scored_rows
from training.labels import patterns
from training.samples import Samples, collect, input_scale
from training.split import Split, everything
from training.tip import TipMetric
from training.trainer import Settings

SAME = 1e-3
"""Difference of coordinates within which two positions are the same [mm, degree] (chosen)."""


class Inputs:
    """The modes of all sensors and channels of a data set, and what was measured beside them.

    Sensors and channels go by their numbers in the data set's order.

    Attributes
    ----------
    samples : measurements of all runs in their order: features (N, F + 1) of all inputs unmixed, a constant last;
        targets (N, P + 3m), the coefficients of the measured terms and the tip at each of m places
    truth : what the metric judges, shape (N, G + 3m): the terms on its grid and the tip
    basis : shape (G + 3m, P + 3m), that from the targets
    readings : temperatures by run, gaps filled, shape (T, S) [°C]
    swing_K : what the features' temperatures are divided by

    Raises
    ------
    DataError
        where the tip was measured at other positions each time.
    """

    def __init__(self, dataset: DataSet, metric: TipMetric, settings: Settings) -> None:
        self.dataset, self.metric, self.settings = dataset, metric, settings
        runs = dataset.runs
        _check_places(dataset)
        model = SensorModel.fit(np.concatenate([run.telemetry.temperatures for run in runs.values()]))
        self.readings = {name: model.fill(run.telemetry.temperatures) for name, run in runs.items()}
        scale = input_scale(dataset, list(runs), model)
        fields = Fields(dataset.machine, dataset.measured_terms, settings.degree)
        net = ThermalNetwork(scale, replace(settings.prior, common=0.0), fields.size)
        self.swing_K, self._largest = scale.swing_K, np.array(scale.largest)
        self._channel_of, self._power = net.channel_of.numpy(), net.power.numpy()
        self._width = len(settings.prior.time_constants_s) + 1
        terms = replace(dataset, runs={name: replace(run, places=None) for name, run in runs.items()}, places=0)
        samples = collect(net, terms, everything(dataset).train, metric.coverage, fields, model)
        constant = np.full((len(samples.features), 1), BIAS_SIZE if dataset.datum == "absolute" else 0.0)
        tip = np.concatenate([run.values[:, len(dataset.columns) :] for run in runs.values()])
        self.samples = replace(
            samples,
            features=np.concatenate([samples.features, constant], axis=1),
            targets=np.concatenate([samples.targets, tip], axis=1),
        )
        self.truth = np.concatenate([metric.sample(run.values) for run in runs.values()])
        on_grid = metric.from_columns(column_basis(fields, dataset.columns))
        self.basis = np.concatenate([on_grid, np.eye(len(on_grid))[:, len(on_grid) - tip.shape[1] :]], axis=1)

    def scale(self, train_runs: list[str]) -> tuple[Array, Array]:
        """Return each sensor's swing within these runs (S,) [K], and by what each heat source is larger there.

        A network that is trained on them scales temperatures by the swing, and channels by their largest value.
        """
        within = [r - r.mean(axis=0) for r in (self.readings[name] for name in train_runs)]
        channels = np.concatenate([self.dataset.runs[name].telemetry.channels for name in train_runs])
        largest = np.abs(channels).max(axis=0)
        share = self._largest / np.where(largest > 0, largest, self._largest)
        return np.sqrt((np.concatenate(within) ** 2).mean(axis=0)), share[self._channel_of] ** self._power

    def chosen(
        self, sensors: list[int], channels: list[int], scale: tuple[Array, Array]
    ) -> tuple[NDArray[np.intp], Array]:
        """Return which features a set has, shape (f,), and the matrix (f, f) that makes the network's own of them."""
        swings_K, shares = scale
        sources = np.flatnonzero(np.isin(self._channel_of, channels))
        first = np.concatenate([np.array(sensors, dtype=np.intp), len(swings_K) + sources]) * self._width
        columns = np.append((first[:, None] + np.arange(self._width)).ravel(), self.samples.features.shape[1] - 1)
        # As in `ThermalNetwork`, with these sensors alone.
        count = len(sensors)
        own = np.eye(count) - (1.0 - np.sqrt(1.0 - self.settings.prior.common)) / max(count, 1)
        swing_K = float(np.sqrt((swings_K[sensors] ** 2).mean())) if count else 1.0
        mix = np.diag(np.append(np.repeat(np.append(np.ones(count), shares[sources]), self._width), 1.0))
        mixed = count * self._width
        mix[:mixed, :mixed] = np.kron(own * self.swing_K / (swing_K or 1.0), np.eye(self._width))
        return columns, mix


def _check_places(dataset: DataSet) -> None:
    places = [run.places for run in dataset.runs.values() if run.places is not None]
    if not places:
        return
    q = np.concatenate(places)  # (N, m, A)
    known = np.where(np.isnan(q), np.inf, q).min(axis=0), np.where(np.isnan(q), -np.inf, q).max(axis=0)
    if (known[1] - known[0] > SAME).any():
        raise DataError(
            f"tool_tip of data set '{dataset.path}' must repeat its positions for sensors to be judged by it, got "
            "others each time; measure the tip at the same few positions again and again, or measure error_terms"
        )


@dataclass(frozen=True)
class Part:
    """Normal equations of the coefficients that were measured at the same times."""

    columns: NDArray[np.intp]
    square: Array
    product: Array


@dataclass(frozen=True)
class Fold:
    """One division of the measurements.

    Attributes
    ----------
    scale : of the training part's inputs
    parts : of the training part
    features, truth : of the left-out part, shapes (n, F + 1) and (n, G + 3m)
    """

    scale: tuple[Array, Array]
    parts: list[Part]
    features: Array
    truth: Array


class SetJudge:
    """Judges sets of sensors and channels by what they leave on what is left out in turn.

    Attributes
    ----------
    folds : the divisions
    drift_um : root mean square of the tip's deviation without compensation, over all that is left out
    """

    def __init__(self, inputs: Inputs, splits: Iterable[Split]) -> None:
        self._inputs = inputs
        self.folds = [self._fold(split) for split in splits]
        drift = np.concatenate([np.zeros((0, len(inputs.basis))), *(fold.truth for fold in self.folds)])
        self.drift_um = float(np.sqrt(inputs.metric.mean_square(drift).mean())) if len(drift) else 0.0

    def residual_um(self, sensors: Iterable[int], channels: Iterable[int]) -> float:
        """Return what is left at the tip with these inputs alone, root mean square over all that is left out."""
        squares = self.squares_um2(sensors, channels)
        return float(np.sqrt(squares.mean())) if len(squares) else 0.0

    def squares_um2(self, sensors: Iterable[int], channels: Iterable[int]) -> Array:
        """Return the mean squares over the volume (n,) [µm²], of one left-out measurement after the other."""
        inputs, squares = self._inputs, [np.zeros(0)]
        wanted, heard = sorted(sensors), sorted(channels)
        for fold in self.folds:
            columns, mix = inputs.chosen(wanted, heard, fold.scale)
            weights = np.zeros((len(columns), inputs.basis.shape[1]))
            for part in fold.parts:
                normal = mix.T @ part.square[np.ix_(columns, columns)] @ mix
                normal[np.diag_indices_from(normal)] += inputs.settings.ridge
                weights[:, part.columns] = mix @ cho_solve(cho_factor(normal), mix.T @ part.product[columns])
            said = fold.features[:, columns] @ (weights @ inputs.basis.T)
            squares.append(inputs.metric.mean_square(fold.truth - said))
        return np.concatenate(squares)

    def _fold(self, split: Split) -> Fold:
        inputs = self._inputs
        runs = inputs.dataset.runs
        inside = np.concatenate([split.train[name] for name in runs])
        scored = scored_rows(inputs.dataset, split.test, inputs.metric).masks
        outside = np.concatenate(
            [scored.get(name, np.zeros(len(run.time_s), dtype=bool)) for name, run in runs.items()]
        )
        return Fold(
            inputs.scale(split.train_runs),
            self._parts(inputs.samples.where(inside)),
            inputs.samples.features[outside],
            inputs.truth[outside],
        )

    def _parts(self, samples: Samples) -> list[Part]:
        """Return the normal equations, whitened and counted as in `decoder.solve_decoder`."""
        parts: list[Part] = []
        for rows, columns in patterns(np.isfinite(samples.targets)):
            if rows.any():
                whitening = Whitening.of(samples.where(rows), self._inputs.settings.correlation_s)
                x = whitening.apply(samples.features[rows])
                y = whitening.apply(samples.targets[np.ix_(rows, columns)])
                parts.append(Part(columns, x.T @ x / whitening.effective, x.T @ y / whitening.effective))
        return parts
