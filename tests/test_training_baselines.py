"""The baselines that the network is judged against."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from shop import TAU_S, touch, write_dataset

from model.exceptions import DataError
from model.sensors import SensorModel
from model.tables import read_table, write_table
from model.telemetry import Run
from training.baselines import arx
from training.baselines.components import Components
from training.baselines.everyone import BASELINES
from training.baselines.inputs import TAUS_S, Inputs
from training.baselines.normal import Normal, by_part, left_out_errors
from training.baselines.parts import grouped, parts
from training.baselines.protocol import Baseline, Task
from training.cli import evaluate
from training.comparison import fit_baselines, with_baselines
from training.dataset import DataSet, load_dataset
from training.evaluation import compare
from training.job import evaluate_bundle, train_bundle
from training.joined import joined
from training.split import everything, split_by_run
from training.tip import tip_metric

RIDGE, AVERAGES, ARX, TREES, GRU = BASELINES
NAMES = [baseline.name for baseline in BASELINES]
RNG = np.random.default_rng(5)


def task_of(data: DataSet, test: list[str]) -> Task:
    split = split_by_run(data, test) if test else everything(data)
    sensors = SensorModel.fit(np.concatenate([data.runs[n].telemetry.temperatures for n in split.train_runs]))
    return Task(data, split, tip_metric(data), sensors)


def share(task: Task, baseline: Baseline) -> float:
    fitted = baseline.fit(task)
    return compare(task.dataset, task.split.test, {"it": fitted.predict}, task.metric)["it"].share


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Train the slow ones hardly at all, where only their form matters."""
    monkeypatch.setattr("training.baselines.gru.STEPS", 11)
    monkeypatch.setattr("training.baselines.trees.MOST_TREES", 5)


@pytest.mark.parametrize("datum", ["absolute", "run-start"])
def test_what_knows_the_past_recovers_a_lag_and_what_does_not_cannot(tmp_path: Path, datum: str) -> None:
    """The shop's terms follow one sensor through a first-order lag: an average says it, and so does ARX."""
    task = task_of(load_dataset(write_dataset(tmp_path / "d", 5, datum=datum)), ["r4"])
    assert TAU_S in TAUS_S
    slow = (TREES, GRU) if datum == "absolute" else ()
    left = {baseline.name: share(task, baseline) for baseline in (RIDGE, AVERAGES, ARX, *slow)}
    assert left[AVERAGES.name] < 0.01
    assert left[ARX.name] < 0.1  # its clock is coarser than the telemetry
    assert left[RIDGE.name] > 3 * max(left[AVERAGES.name], left[ARX.name])
    assert left.get(TREES.name, 0.0) < 0.8
    assert left.get(GRU.name, 0.0) < 0.3


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("baseline", BASELINES, ids=NAMES)
def test_nothing_measured_at_test_is_seen_in_training_or_prediction(tmp_path: Path, baseline: Baseline) -> None:
    data = load_dataset(write_dataset(tmp_path / "d", 4, 4.0, datum="run-start"))
    said = baseline.fit(task_of(data, ["r3"])).predict(data.runs["r3"])
    other = replace(data.runs["r3"], values=RNG.normal(0.0, 100.0, data.runs["r3"].values.shape))
    disturbed = replace(data, runs={**data.runs, "r3": other})
    task = task_of(disturbed, ["r3"])
    np.testing.assert_allclose(baseline.fit(task).predict(other), said, rtol=1e-9, atol=1e-9)
    assert np.abs(said).max() > 0.0
    np.testing.assert_allclose(said[0], 0.0, atol=1e-9)  # the datum


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("baseline", BASELINES, ids=NAMES)
@pytest.mark.parametrize("runs", [1, 4])
def test_gaps_in_sensors_terms_and_channels(tmp_path: Path, baseline: Baseline, runs: int) -> None:
    data = load_dataset(write_dataset(tmp_path / "d", runs, 4.0))
    for run in data.runs.values():
        run.values[1::2, 3] = np.nan  # EZ0T and EXX in turn
        run.values[::2, :3] = np.nan
        run.telemetry.temperatures[::5, 0] = np.nan
    bare = {
        name: replace(run, telemetry=replace(run.telemetry, channels=run.telemetry.channels[:, :0]))
        for name, run in data.runs.items()
    }
    data = replace(data, channels=(), runs=bare)
    task = task_of(data, ["r3"] if runs > 1 else [])
    said = baseline.fit(task).predict(data.runs["r0"])
    assert said.shape == (len(data.runs["r0"].time_s), 5)
    assert np.isfinite(said).all()
    assert np.abs(said).max(axis=0)[-1] > 0.0  # EZ0T is learned from the times that show it
    assert np.abs(said).max(axis=0)[3] > 0.0  # and so is EXX


@pytest.mark.parametrize("baseline", [TREES, GRU], ids=["trees", "gru"])
@pytest.mark.usefixtures("short")
def test_one_seed_gives_one_result(tmp_path: Path, baseline: Baseline) -> None:
    data = load_dataset(write_dataset(tmp_path / "d", 3, 4.0))
    one, other = (baseline.fit(task_of(data, ["r2"])).predict(data.runs["r2"]) for _ in range(2))
    np.testing.assert_array_equal(one, other)


def test_parts_are_whole_runs_or_phases_or_stretches(tmp_path: Path) -> None:
    data = load_dataset(write_dataset(tmp_path / "d", 3, 5.0))
    by_run = parts(data, split_by_run(data, ["r1"]))
    assert {name: np.unique(number).tolist() for name, number in by_run.items()} == {"r0": [0], "r2": [1]}
    run = data.runs["r0"]
    speed = np.repeat([0.0, 3000.0, 0.0, 9000.0], len(run.telemetry.time_s) // 4 + 1)[: len(run.telemetry.time_s)]
    alone = replace(data, runs={"r0": replace(run, telemetry=replace(run.telemetry, channels=speed[:, None]))})
    phases = parts(alone, everything(alone))["r0"]
    assert np.unique(phases).tolist() == [0, 1, 2, 3]
    for phase in range(4):
        assert len(np.unique(speed[np.searchsorted(run.telemetry.time_s, run.time_s[phases == phase])])) == 1
    silent = replace(alone, channels=(), runs={"r0": replace(run, telemetry=replace(run.telemetry))})
    assert np.bincount(parts(silent, everything(silent))["r0"]).tolist() == [10] * 5
    groups = grouped(np.array([-1, 0, 1, 2, 3, 4]), 2)
    assert [g.tolist() for g in groups] == [
        [False, True, False, True, False, True],
        [False, False, True, False, True, False],
    ]
    assert grouped(np.zeros(5, dtype=np.intp), 4) == []


def test_components_keep_the_tips_mean_square(tmp_path: Path) -> None:
    metric = tip_metric(load_dataset(write_dataset(tmp_path / "d", 1, 1.0)))
    values = RNG.normal(size=(50, 2)) @ RNG.normal(size=(2, len(metric.gram)))
    components = Components.of(values, metric.gram)
    assert components.count == 2
    scores = components.scores(values)
    np.testing.assert_allclose((scores**2).sum(axis=1), metric.mean_square(values), rtol=1e-4)
    np.testing.assert_allclose(metric.mean_square(values - components.grid(scores)), 0.0, atol=1e-6)


def test_ridge_from_sums_is_ridge(tmp_path: Path) -> None:
    """Against the augmented least-squares problem, and left-out parts against fitting anew."""
    x, part = RNG.normal(size=(60, 4)), np.arange(60) // 15
    x[:, 3] = 1.0
    y = x @ RNG.normal(size=(4, 2)) + RNG.normal(size=(60, 2))
    free, penalties = np.array([False, False, False, True]), np.array([0.5, 20.0])

    def direct(rows: np.ndarray, penalty: float) -> np.ndarray:
        stacked = np.concatenate([x[rows], np.sqrt(penalty) * np.eye(4)[:3]])
        return np.linalg.lstsq(stacked, np.concatenate([y[rows], np.zeros((3, 2))]))[0]

    weights = Normal.of(x, y).solve(penalties, free)
    errors = np.zeros(2)
    for i, penalty in enumerate(penalties.tolist()):
        np.testing.assert_allclose(weights[i], direct(part >= 0, penalty), rtol=1e-6)
        for k in range(4):
            errors[i] += ((y[part == k] - x[part == k] @ direct(part != k, penalty)) ** 2).sum()
    np.testing.assert_allclose(left_out_errors(by_part(x, y, part), penalties, free), errors, rtol=1e-6)


def test_averages_answer_a_ramp_as_a_lag_does_however_it_is_sampled() -> None:
    """h = t - τ (1 - exp(-t / τ)) for an input that grows with time."""
    time_s = np.concatenate([[0.0], np.sort(RNG.uniform(1.0, 8e4, 40))])
    run = Run("r", time_s, 20.0 + time_s[:, None] / 3600.0, np.zeros((41, 0)))
    sensors = SensorModel(np.zeros(1), np.eye(1))
    inputs = Inputs(1, np.array([20.0]), np.ones(1), False, sensors)
    found = inputs.averages(run)[:, 0]
    for k, tau in enumerate(TAUS_S, start=1):
        np.testing.assert_allclose(found[:, k], (time_s - tau * (1 - np.exp(-time_s / tau))) / 3600.0, atol=1e-9)


def test_no_free_run_diverges_and_a_steady_state_stays(tmp_path: Path) -> None:
    wild = np.array([2.5, -1.0, 0.3, 0.1, 0.0])
    tame = arx.stable(wild, 2)
    assert np.abs(np.roots([1.0, *-tame[:2]])).max() <= arx.SLOWEST + 1e-9
    np.testing.assert_allclose(arx.stable(tame, 2), tame, rtol=1e-12)
    task = task_of(load_dataset(write_dataset(tmp_path / "d", 2, 1.0)), ["r1"])
    order = arx.Order(1, 1, 1, 2)
    weights = np.array([0.9, 0.2, 0.1, 0.5])
    steady = arx.free_run(weights, order, np.tile([1.0, 2.0, 0.0], (20, 1)), task)
    np.testing.assert_allclose(steady, (0.2 + 0.2 + 0.5) / 0.1)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("whole") / "d", 4, 4.0)


@pytest.fixture(scope="module")
def bundle(whole: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return train_bundle(whole, tmp_path_factory.mktemp("bundle") / "b", ["r3"], 0).bundle.path


def part_of(whole: Path, folder: Path, runs: list[str]) -> Path:
    """Return a copy of the data set with some of its runs."""
    folder.mkdir()
    for name in ("machine.toml", "dataset.toml"):
        (folder / name).write_text((whole / name).read_text())
    for name in ("telemetry.csv", "error_terms.csv"):
        head, *rows = (whole / name).read_text().splitlines()
        (folder / name).write_text("\n".join([head, *(r for r in rows if r.split(",")[0] in runs)]) + "\n")
    return folder


@pytest.mark.usefixtures("short")
def test_training_data_of_its_own_gives_what_one_data_set_gives(whole: Path, bundle: Path, tmp_path: Path) -> None:
    one = with_baselines(evaluate_bundle(bundle, whole, ["r3"]), None)
    test = part_of(whole, tmp_path / "test", ["r3"])
    train = part_of(whole, tmp_path / "train", ["r0", "r1", "r2"])
    two = with_baselines(evaluate_bundle(bundle, test, None), train)
    assert one.trained_on == ["r0", "r1", "r2"]
    assert two.trained_on == ["train/r0", "train/r1", "train/r2"]
    assert set(one.result.scores) == {"no compensation", "thermal network", *NAMES}
    for name, score in one.result.scores.items():
        assert two.result.scores[name].rms_um == pytest.approx(score.rms_um, rel=1e-6)


@pytest.mark.usefixtures("short")
def test_training_data_that_does_not_fit_is_refused(whole: Path, bundle: Path, tmp_path: Path) -> None:
    result = evaluate_bundle(bundle, whole, None)
    with pytest.raises(DataError, match=r"baselines must have runs to train on, got all 4 of '.*' to test on; name so"):
        with_baselines(result, None)
    with pytest.raises(DataError, match="baselines must have runs to train on"):
        with_baselines(result, whole)
    data = load_dataset(whole)
    other = part_of(whole, tmp_path / "other", ["r0"])
    (other / "dataset.toml").write_text('datum = "run-start"\n')
    with pytest.raises(DataError, match="--train-on '.*' must have datum 'absolute' as '.*' has"):
        joined(data, load_dataset(other))
    (other / "dataset.toml").write_text('datum = "absolute"\n')
    table = read_table(other / "telemetry.csv")
    del table.numbers["spindle_rpm"]
    cells = {name: column.tolist() for name, column in table.numbers.items()}
    write_table(other / "telemetry.csv", {"run": table.text["run"].tolist(), **cells})
    with pytest.raises(DataError, match="--train-on '.*' must have channel 'spindle_rpm', got none"):
        joined(data, load_dataset(other))


@pytest.mark.usefixtures("short")
def test_the_command_prints_one_table_and_json(whole: Path, bundle: Path) -> None:
    def run(*args: object) -> Result:
        return CliRunner().invoke(evaluate, [str(a) for a in args])

    done = run(bundle, whole, "--runs", "r3", "--baselines", "--json")
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert set(NAMES) < set(told["scores"])
    assert told["baselines"]["trained_on"] == ["r0", "r1", "r2"]
    assert set(told["baselines"]["settings"]) == set(NAMES)
    best = min(told["scores"][name]["rms_um"] for name in NAMES)
    assert told["network_by_best_baseline"] == pytest.approx(told["scores"]["thermal network"]["rms_um"] / best)
    wrong = run(bundle, whole, "--train-on", whole)
    assert wrong.exit_code == 2
    assert "--train-on says what to train the baselines on; give --baselines, too" in wrong.stderr


def test_where_the_tip_was_measured_terms_are_identified_first(tmp_path: Path) -> None:
    folder = touch(write_dataset(tmp_path / "d", 3, 4.0, lag=False), 4)
    (folder / "error_terms.csv").unlink()
    data = load_dataset(folder)
    split, metric = split_by_run(data, ["r2"]), tip_metric(data)
    trained = fit_baselines(data, split, metric, 3, (RIDGE,))
    methods = {name: one.predict for name, one in trained.items()}
    assert compare(data, split.test, methods, metric)[RIDGE.name].share < 0.2
