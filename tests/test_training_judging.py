"""The measure and the baseline that everything is judged by."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shop import write_dataset

from model.chain import Chain
from model.error_map import ErrorMap
from model.exceptions import DataError
from model.sensors import SensorModel
from training.baselines import fit_ridge
from training.dataset import DataSet, load_dataset
from training.evaluation import NO_COMPENSATION, RIDGE, compare
from training.split import split_by_run
from training.tip import tip_metric


def dataset(tmp_path: Path, **options: object) -> DataSet:
    return load_dataset(write_dataset(tmp_path / "d", **options))  # type: ignore[arg-type]


def test_the_tip_metric_is_the_chain_to_first_order(tmp_path: Path) -> None:
    data = dataset(tmp_path, runs=1)
    metric = tip_metric(data)
    values = np.array([[1.0, -2.0, 3.0, 4.0]])  # EXX at 0, 400, 800 and EZ0T [µm]
    rows = [(t, p, v) for (t, p), v in zip(data.columns, values[0], strict=True)]
    errors = ErrorMap.from_rows(data.machine, rows)
    chain = Chain(data.machine)
    exact = chain.deviation(metric.positions, errors.evaluate(metric.positions)).position_mm * 1e3
    sampled = metric.sample(values)
    np.testing.assert_allclose(metric.deviation(sampled)[0], exact, atol=1e-6)
    assert metric.mean_square(sampled)[0] == pytest.approx((exact**2).sum(axis=1).mean(), rel=1e-6)


def test_the_metric_is_linear_between_what_a_time_shows_and_ignores_terms_that_it_does_not(tmp_path: Path) -> None:
    data = with_columns(dataset(tmp_path, runs=1), (0.0, 200.0, 400.0, 600.0, 800.0))
    data.runs["r0"].values[0, 1] = np.nan
    metric = tip_metric(data)
    whole = metric.sample(np.array([[1.0, 2.0, 3.0, 2.0, 1.0, 5.0]]))
    np.testing.assert_allclose(metric.sample(np.array([[1.0, np.nan, 3.0, 2.0, 1.0, 5.0]])), whole)
    half = metric.sample(np.array([[1.0, 2.0, np.nan, np.nan, np.nan, 5.0]]))
    assert np.isnan(half[0, :4]).all()
    assert not metric.whole(half).any()
    alone = metric.sample(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 5.0]]))
    np.testing.assert_allclose(metric.mean_square(half), metric.mean_square(alone))


def with_columns(data: DataSet, positions: tuple[float, ...]) -> DataSet:
    """Return the data set with EXX measured at these positions; it runs linearly along X."""
    columns = (*(("EXX", p) for p in positions), ("EZ0T", None))
    runs = {
        name: replace(
            run, values=np.concatenate([run.values[:, [2]] * np.array(positions) / 800.0, run.values[:, [3]]], axis=1)
        )
        for name, run in data.runs.items()
    }
    return replace(data, columns=columns, runs=runs)


@pytest.mark.parametrize("datum", ["absolute", "run-start"])
def test_ridge_recovers_a_linear_truth(tmp_path: Path, datum: str) -> None:
    data = dataset(tmp_path, lag=False, datum=datum)
    split = split_by_run(data, ["r3"])
    metric = tip_metric(data)
    sensors = SensorModel.fit(np.concatenate([r.telemetry.temperatures for r in data.runs.values()]))
    ridge = fit_ridge(data, split, metric, sensors)
    scores = compare(data, split.test, {RIDGE: ridge.predict}, metric)
    assert scores[NO_COMPENSATION].share == 1.0
    assert scores[RIDGE].share < 1e-3


def test_ridge_copes_with_gaps(tmp_path: Path) -> None:
    data = dataset(tmp_path, lag=False)
    for run in data.runs.values():
        run.values[::2, 0] = np.nan
        run.values[:5, 3] = np.nan
    split = split_by_run(data, ["r0"])
    metric = tip_metric(data)
    sensors = SensorModel.fit(np.concatenate([r.telemetry.temperatures for r in data.runs.values()]))
    scores = compare(data, split.test, {RIDGE: fit_ridge(data, split, metric, sensors).predict}, metric)
    assert scores[RIDGE].share < 1e-3


def test_a_perfect_method_leaves_nothing_and_a_silent_one_everything(tmp_path: Path) -> None:
    data = dataset(tmp_path)
    everything = {name: np.ones(len(run.time_s), dtype=bool) for name, run in data.runs.items()}
    metric = tip_metric(data)
    methods = {"perfect": lambda run: metric.sample(run.values), "silent": lambda run: 0.0 * metric.sample(run.values)}
    scores = compare(data, everything, methods, metric)
    assert scores["perfect"].rms_um == 0.0
    assert scores["silent"] == scores[NO_COMPENSATION]


def test_nothing_to_test_on_and_nothing_that_moves(tmp_path: Path) -> None:
    data = dataset(tmp_path, runs=2)
    metric = tip_metric(data)
    with pytest.raises(DataError, match="data set '.*' must have measurements to test on, got none"):
        compare(data, {"r0": np.zeros(61, dtype=bool)}, {}, metric)
    for run in data.runs.values():
        run.values[:] = 0.0
    whole = {"r0": np.ones(len(data.runs["r0"].time_s), dtype=bool)}
    with pytest.raises(DataError, match="measurements to test on in data set '.*' must show some drift, got values"):
        compare(data, whole, {}, metric)
    with pytest.raises(DataError, match="the measured terms of data set '.*' must move the tool tip; none of them"):
        compare(data, whole, {}, replace(metric, gram=0.0 * metric.gram))
