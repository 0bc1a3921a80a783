"""The choice of prior sizes and penalty by runs that are left out whole."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from shop import write_dataset

from model.fields import Fields
from model.network import InputScale, Prior, ThermalNetwork
from model.sensors import SensorModel
from training.choice import LEAST_RUNS, _LeftOut, _sizes, choose
from training.dataset import DataSet, load_dataset
from training.decoder import Normal, solve_decoder
from training.samples import Samples
from training.split import everything
from training.tip import tip_metric
from training.trainer import Settings

OTHER = Prior(powers=(1.0, 2.0), source=5.0, instant=0.7, tau_exponent=-0.3, common=0.8)
PLAIN = replace(OTHER, source=1.0, instant=1.0, tau_exponent=0.0, common=0.0)
SCALE = InputScale([20.0, 21.0, 22.0], 3.0, [8000.0, 1.0], [False, True])


def drawn(rows: int = 60, width: int = 6, outputs: int = 4, *, gaps: bool = True) -> Samples:
    """Return random samples of three runs, the last coefficient not measured at some times."""
    rng = np.random.default_rng(5)
    targets = rng.normal(size=(rows, outputs))
    if gaps:
        targets[10:25, -1] = np.nan
    run = np.repeat(np.arange(3), rows // 3)
    features = rng.normal(size=(rows, width))
    return Samples(features, 0.0 * features, targets, run, 300.0 * np.tile(np.arange(rows // 3), 3).astype(float))


def measured(tmp_path: Path, runs: int) -> DataSet:
    return load_dataset(write_dataset(tmp_path / "data", runs=runs))


def arguments(dataset: DataSet) -> tuple[object, ...]:
    readings = np.concatenate([run.telemetry.temperatures for run in dataset.runs.values()])
    return dataset, everything(dataset), tip_metric(dataset), SensorModel.fit(readings)


def test_features_of_other_sizes_follow_by_the_matrix() -> None:
    plain, net = (ThermalNetwork(SCALE, prior, 1) for prior in (PLAIN, OTHER))
    rng = np.random.default_rng(0)
    raw = torch.tensor(np.concatenate([rng.normal(22, 3, (1, 50, 3)), rng.uniform(0, 1, (1, 50, 2))], axis=2))
    dt_s = torch.full((1, 50), 60.0, dtype=torch.float64)
    with torch.no_grad():
        before, after = (n.sequence(raw, dt_s)[0].numpy() for n in (plain, net))
    mix, factor = _sizes(plain, net)
    np.testing.assert_allclose(before @ mix * factor, after, atol=1e-12)


@pytest.mark.parametrize("bias", [False, True])
def test_the_normal_equations_give_the_decoder_of_other_sizes(bias: bool) -> None:
    samples = drawn()
    sizes = np.random.default_rng(1).uniform(0.1, 2.0, 6)
    moved = replace(samples, features=samples.features * sizes)
    weights, shift = solve_decoder(moved, ridge=0.3, correlation_s=600.0, bias=bias)
    found, constant = Normal.of(samples, 600.0, bias=bias).solve(0.3, sizes)
    np.testing.assert_allclose(found, sizes[:, None] * weights, atol=1e-10)
    np.testing.assert_allclose(constant, shift, atol=1e-10)
    assert bias == bool(np.any(constant))


def test_what_is_left_follows_from_the_sums() -> None:
    samples = drawn()
    rng = np.random.default_rng(2)
    weights, bias, half = rng.normal(size=(6, 4)), rng.normal(size=4), rng.normal(size=(4, 4))
    form = half @ half.T
    rest = np.nan_to_num(samples.targets - samples.features @ weights - bias)
    known = np.nan_to_num(samples.targets)
    sums = _LeftOut.of(samples, form)
    assert sums.left(weights, bias) == pytest.approx(((rest @ form) * rest).sum())
    assert sums.square == pytest.approx(((known @ form) * known).sum())


def test_few_runs_keep_the_settings_and_more_runs_leave_less(tmp_path: Path) -> None:
    few = measured(tmp_path / "few", LEAST_RUNS - 1)
    assert choose(*arguments(few), Settings()).settings == Settings()  # type: ignore[arg-type]
    enough = measured(tmp_path / "enough", LEAST_RUNS)
    absurd = replace(Settings(), ridge=100.0)
    chosen = choose(*arguments(enough), absurd)  # type: ignore[arg-type]
    assert chosen.settings.ridge < 1.0
    assert chosen.left is not None
    assert chosen.left_before is not None
    assert chosen.left < chosen.left_before
    assert chosen == choose(*arguments(enough), absurd)  # type: ignore[arg-type]


def test_choosing_again_from_what_was_chosen_changes_nothing(tmp_path: Path) -> None:
    dataset = measured(tmp_path, LEAST_RUNS)
    _, split, metric, sensors = arguments(dataset)
    chosen = choose(dataset, split, metric, sensors, Settings())  # type: ignore[arg-type]
    assert Fields(dataset.machine, dataset.terms, chosen.settings.degree).size > 0
    again = choose(dataset, split, metric, sensors, chosen.settings)  # type: ignore[arg-type]
    assert again.settings == chosen.settings  # nothing is better than the best
    assert again.left == again.left_before == pytest.approx(chosen.left)


def test_times_that_each_show_other_terms_cost_no_sum_each() -> None:
    """What is kept of left-out samples grows with the samples, not with the sets of terms that they show."""
    samples = drawn(rows=600)
    holes = np.random.default_rng(3).random(samples.targets.shape) < 0.3
    ragged = replace(samples, targets=np.where(holes, np.nan, samples.targets))
    form = np.eye(4)
    assert len(_LeftOut.of(ragged, form).features) <= 16 * (6 + 1 + 4)  # as many sets, as many columns
    few = samples.where(np.arange(600) < 8)
    assert len(_LeftOut.of(few, form).features) == 8
    rng = np.random.default_rng(2)
    weights, bias = rng.normal(size=(6, 4)), rng.normal(size=4)
    rest = np.nan_to_num(ragged.targets - ragged.features @ weights - bias)
    assert _LeftOut.of(ragged, form).left(weights, bias) == pytest.approx((rest**2).sum())
