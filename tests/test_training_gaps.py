"""Measurements and telemetry that are not a full grid: varying positions, terms and sensors taken in turn."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shop import write_dataset

from model.bundle import load_bundle
from model.exceptions import ComputeError, DataError
from model.fields import Fields
from model.tables import read_table, write_table
from training.baselines import fit_ridge
from training.coverage import coverage
from training.dataset import DataSet, load_dataset
from training.evaluation import NETWORK, NO_COMPENSATION, RIDGE, compare, scored_rows
from training.job import train_bundle
from training.labels import to_coefficients
from training.split import everything, split_by_run
from training.tip import tip_metric
from training.trained import Task, Trained
from training.trainer import Settings, Verdict

RNG = np.random.default_rng(11)
RUNS, HOURS = 3, 3.0


def remeasured(folder: Path, positions: Callable[[int], list[float]], z_too: Callable[[int], bool]) -> Path:
    """Measure the shop's EXX = -EZ0T * X / 250 mm at other positions, and EZ0T only at some times, counted by run."""
    table = read_table(folder / "error_terms.csv", text=("run", "term"))
    z = np.flatnonzero(table.text["term"] == "EZ0T")
    rows: list[tuple[object, ...]] = []
    for run in dict.fromkeys(table.text["run"].tolist()):
        for count, i in enumerate(z[table.text["run"][z] == run]):
            time_s, value = float(table.numbers["time_s"][i]), float(table.numbers["value"][i])
            rows += [(run, time_s, "EXX", p, -value * p / 250.0) for p in positions(count)]
            rows += [(run, time_s, "EZ0T", "", value)] if z_too(count) else []
    columns = dict(zip(("run", "time_s", "term", "position", "value"), map(list, zip(*rows, strict=True)), strict=True))
    write_table(folder / "error_terms.csv", columns)
    return folder


def varying(_count: int) -> list[float]:
    """Return both ends and three positions that no other time has."""
    return [0.0, *np.sort(RNG.uniform(1.0, 799.0, 3)).round(3).tolist(), 800.0]


def always(_count: int) -> bool:
    return True


@pytest.fixture(scope="module")
def varied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return remeasured(write_dataset(tmp_path_factory.mktemp("varied") / "d", RUNS, HOURS), varying, always)


def test_positions_of_their_own_at_each_time_say_what_a_grid_says(varied: Path, tmp_path: Path) -> None:
    """EXX runs linearly along X, so drift, labels and scores must not depend on where it was measured."""
    grid = load_dataset(write_dataset(tmp_path / "grid", RUNS, HOURS))
    apart = load_dataset(varied)
    assert len(apart.columns) > 100
    fields = Fields(grid.machine, grid.terms, 3)
    labels = [to_coefficients(d.runs["r1"].values, coverage(d), fields) for d in (grid, apart)]
    assert np.isfinite(labels[1]).all()
    # Three positions leave a cubic open, and the penalty keeps it to an eightieth; five settle it.
    np.testing.assert_allclose(labels[1], labels[0], atol=0.02 * np.abs(labels[0]).max())
    everything = {name: np.ones(len(run.time_s), dtype=bool) for name, run in grid.runs.items()}
    metrics = [tip_metric(d) for d in (grid, apart)]
    scores = [compare(d, everything, {}, m)[NO_COMPENSATION] for d, m in zip((grid, apart), metrics, strict=True)]
    assert scores[1].rms_um == pytest.approx(scores[0].rms_um)
    half = compare(apart, everything, {"half": lambda run: 0.5 * metrics[1].sample(run.values)}, metrics[1])["half"]
    assert half.share == pytest.approx(0.5)
    ridges = []
    for data, metric in zip((grid, apart), metrics, strict=True):
        split = split_by_run(data, ["r0"])
        trained = _sensors(data)
        ridges.append(
            compare(data, split.test, {RIDGE: fit_ridge(data, split, metric, trained).predict}, metric)[RIDGE]
        )
    assert ridges[1].share == pytest.approx(ridges[0].share, abs=1e-6)


def _sensors(data: DataSet):  # type: ignore[no-untyped-def]
    from model.sensors import SensorModel

    return SensorModel.fit(np.concatenate([run.telemetry.temperatures for run in data.runs.values()]))


def test_a_network_learns_from_varying_positions(varied: Path, tmp_path: Path) -> None:
    result = train_bundle(varied, tmp_path / "bundle", ["r2"], 0)
    assert result.scores[NETWORK].share < 0.1
    assert result.scores[NETWORK].share < 0.5 * result.scores[RIDGE].share
    assert result.note == ""


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        (lambda count: [400.0 * (count % 3)], "EXX at some time at 2 or more .* span 400 mm, .* got at most 1 at one"),
        (lambda count: [[0.0, 100.0], [700.0, 800.0]][count % 2], "EXX at some time at 2 or more .* got at most 2 at"),
    ],
)
def test_a_term_that_no_time_shows_is_refused(
    tmp_path: Path, positions: Callable[[int], list[float]], message: str
) -> None:
    data = load_dataset(remeasured(write_dataset(tmp_path / "d", 2, 1.0), positions, always))
    with pytest.raises(DataError, match=f"data set '.*' must show {message}"):
        tip_metric(data)


def test_a_term_measured_at_one_position_alone_counts_where_it_is_shown(tmp_path: Path) -> None:
    data = load_dataset(remeasured(write_dataset(tmp_path / "d", 1, 1.0), lambda _: [800.0], always))
    assert tip_metric(data).whole(tip_metric(data).sample(data.runs["r0"].values)).all()


def test_measurements_that_lack_a_term_are_not_scored_and_it_is_said(tmp_path: Path) -> None:
    """A term that was not measured is not a term that stood still."""
    folder = remeasured(write_dataset(tmp_path / "d", 2, 2.0), lambda _: [0.0, 400.0, 800.0], lambda n: n % 4 == 0)
    data = load_dataset(folder)
    metric = tip_metric(data)
    mask = {"r0": np.ones(len(data.runs["r0"].time_s), dtype=bool)}
    scored = scored_rows(data, mask, metric)
    assert scored.masks["r0"].tolist() == [n % 4 == 0 for n in range(20)]
    assert scored.note == "15 of 20 measurements do not show all terms and are not scored"
    fourth = replace(data.runs["r0"], time_s=data.runs["r0"].time_s[::4], values=data.runs["r0"].values[::4])
    alone = compare(replace(data, runs={"r0": fourth}), {"r0": np.ones(5, dtype=bool)}, {}, metric)
    assert compare(data, mask, {}, metric) == alone


def test_terms_measured_in_turn_are_scored_by_what_each_time_shows(tmp_path: Path) -> None:
    data = load_dataset(
        remeasured(
            write_dataset(tmp_path / "d", 1, 2.0), lambda n: [0.0, 400.0, 800.0] if n % 2 else [], lambda n: n % 2 == 0
        )
    )
    scored = scored_rows(data, {"r0": np.ones(20, dtype=bool)}, tip_metric(data))
    assert scored.masks["r0"].all()
    assert scored.note == "none of 20 measurements shows all terms: each is scored by the terms that it shows"


def test_a_term_only_in_the_left_out_runs_is_refused(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "d", 2, 1.0)
    rows = (folder / "error_terms.csv").read_text().splitlines()
    (folder / "error_terms.csv").write_text("\n".join(r for r in rows if not r.startswith("r0") or "EXX" in r) + "\n")
    data = load_dataset(folder)
    with pytest.raises(DataError, match="measurements to train on must show EZ0T, got it in the left-out part of"):
        Trained.of(Task(data, split_by_run(data, ["r1"]), tip_metric(data), Settings()))


def test_sensors_logged_in_turn_train_and_ranges_are_those_of_the_training_runs(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "d", RUNS, HOURS)
    table = read_table(folder / "telemetry.csv")
    spindle, ambient = table.numbers["spindle"], table.numbers["ambient"]
    late = table.text["run"] == "r2"
    spindle[late] += 30.0
    table.numbers["spindle_rpm"][late] *= 2.0
    for column, turn in ((spindle, 0), (ambient, 1)):
        column[np.arange(len(column)) % 2 == turn] = np.nan
    cells = {name: ["" if np.isnan(v) else v for v in column] for name, column in table.numbers.items()}
    write_table(folder / "telemetry.csv", {"run": table.text["run"].tolist(), **cells})
    result = train_bundle(folder, tmp_path / "bundle", ["r2"], 0)
    record = load_bundle(result.bundle.path).manifest.network
    assert record is not None
    assert record.valid_range_degC["spindle"] == (np.nanmin(spindle[~late]), np.nanmax(spindle[~late]))
    rpm = table.numbers["spindle_rpm"]
    assert record.valid_range_channels == {"spindle_rpm": (rpm[~late].min(), rpm[~late].max())}
    assert rpm[late].max() > rpm[~late].max()


@pytest.mark.parametrize(
    ("factor", "message"),
    [(0.0, "measurements to test on in data set '.*' must show some drift, got values that leave the tool tip")],
)
def test_a_machine_that_stood_still_is_found_before_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, factor: float, message: str
) -> None:
    folder = write_dataset(tmp_path / "d", 2, 1.0)
    table = read_table(folder / "error_terms.csv", text=("run", "term"))
    cells = {n: ["" if np.isnan(v) else v for v in c] for n, c in table.numbers.items()}
    cells["value"] = (factor * table.numbers["value"]).tolist()
    write_table(folder / "error_terms.csv", {**{n: c.tolist() for n, c in table.text.items()}, **cells})
    monkeypatch.setattr("training.trained.train_network", None)
    with pytest.raises(DataError, match=message):
        train_bundle(folder, tmp_path / "bundle", None, 0)
    (folder / "error_terms.csv").write_text(
        "run,time_s,term,position,value\n" + "".join(f"r{r},{t},EA0T,,{t}\n" for r in (0, 1) for t in (0, 120))
    )
    text = (folder / "machine.toml").read_text()
    offset = next(line for line in text.splitlines() if line.startswith("offset_mm"))
    (folder / "machine.toml").write_text(text.replace(offset, "offset_mm = [0.0, 0.0, 0.0]"))
    with pytest.raises(DataError, match="the measured terms of data set '.*' must move the tool tip; none of them"):
        train_bundle(folder, tmp_path / "bundle", None, 0)


def test_a_loss_that_is_not_finite_stops_the_training(tmp_path: Path) -> None:
    data = load_dataset(write_dataset(tmp_path / "d", 2, 6.0))
    task = Task(data, split_by_run(data, ["r1"]), tip_metric(data), Settings(learning_rate=float("inf"), folds=1))
    with pytest.raises(
        ComputeError, match="the loss must be finite, got nan at step 2 of the nonlinear residual; look"
    ):
        Trained.of(replace(task, split=everything(data)), Verdict(True, 1.0, 1.0))
