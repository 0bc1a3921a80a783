"""What each sensor is worth, and which few do nearly as well as all."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from shop import write_dataset

from model.chain import Chain
from model.exceptions import DataError
from model.sensors import SensorModel
from model.tables import read_table, write_table
from model.terms import UM
from training.dataset import DataSet, load_dataset
from training.evaluation import column_basis
from training.folds import folds
from training.sensor_likeness import alike, told_best
from training.sensor_selection import Selection, select
from training.sensor_sets import Inputs, SetJudge
from training.split import Split, split_by_run
from training.tip import tip_metric
from training.trainer import Settings, Verdict, train_network


def write_shop(folder: Path, runs: int = 4, **options: object) -> Path:
    """Write the shop's data with two sensors more: `twin` of the spindle's, and `idle`, which nothing follows."""
    write_dataset(folder, runs, **options)  # type: ignore[arg-type]
    with (folder / "machine.toml").open("a") as file:
        file.write("\n[sensors.twin]\n[sensors.idle]\n")
    table = read_table(folder / "telemetry.csv", ("run",), ("run",))
    rng = np.random.default_rng(7)
    spindle = table.numbers["spindle"]
    columns = {"run": table.text["run"].tolist(), **{n: v.tolist() for n, v in table.numbers.items()}}
    columns["twin"] = (spindle + rng.normal(0, 0.1, len(spindle))).tolist()
    columns["idle"] = (20.0 + np.cumsum(rng.normal(0, 0.1, len(spindle)))).tolist()
    write_table(folder / "telemetry.csv", columns)
    return folder


def selected(data: DataSet, loss: float = 0.1) -> Selection:
    return select(Inputs(data, tip_metric(data), Settings()), folds(data), loss)


def only(data: DataSet, sensors: list[int], channels: list[int]) -> DataSet:
    """Return the data set as if it had only these inputs."""
    runs = {
        name: replace(
            run,
            telemetry=replace(
                run.telemetry,
                temperatures=run.telemetry.temperatures[:, sensors],
                channels=run.telemetry.channels[:, channels],
            ),
        )
        for name, run in data.runs.items()
    }
    names, heard = tuple(data.sensors[i] for i in sensors), tuple(data.channels[i] for i in channels)
    return replace(data, sensors=names, channels=heard, runs=runs)


def left_by_training(data: DataSet, split: Split) -> float:
    """Return what a network leaves on the left-out runs that was trained without its nonlinear residual."""
    metric = tip_metric(data)
    sensors = SensorModel.fit(np.concatenate([data.runs[n].telemetry.temperatures for n in split.train_runs]))
    trained = train_network(data, split, metric, sensors, Settings(), Verdict(False, 0.0, 0.0))
    basis = metric.from_columns(column_basis(trained.fields, data.columns))
    squares = []
    for name in split.test_runs:
        run = data.runs[name]
        inputs = torch.tensor(np.concatenate([run.telemetry.temperatures, run.telemetry.channels], axis=1)[None])
        dt_s = torch.tensor(np.diff(run.telemetry.time_s, prepend=run.telemetry.time_s[0])[None])
        with torch.no_grad():
            said = trained.net.decode(trained.net.sequence(inputs, dt_s))[0].numpy()
        if data.datum == "run-start":
            said = said - said[0]
        squares.append(metric.mean_square(metric.sample(run.values) - run.between(said) @ basis.T))
    return float(np.sqrt(np.concatenate(squares).mean()))


@pytest.mark.parametrize("datum", ["absolute", "run-start"])
@pytest.mark.parametrize(("sensors", "channels"), [([0, 1, 2, 3], [0]), ([0, 3], [0]), ([2], []), ([1, 3, 2], [])])
def test_a_set_leaves_what_a_network_leaves_that_is_trained_on_it(
    tmp_path: Path, datum: str, sensors: list[int], channels: list[int]
) -> None:
    data = load_dataset(write_shop(tmp_path / "d", datum=datum))
    split = split_by_run(data, ["r2"])
    judge = SetJudge(Inputs(data, tip_metric(data), Settings()), [split])
    expected = left_by_training(only(data, sorted(sensors), channels), split)
    assert judge.residual_um(sensors, channels) == pytest.approx(expected, rel=1e-6)


def test_the_sensor_that_the_drift_follows_is_found_with_its_twin(tmp_path: Path) -> None:
    found = selected(load_dataset(write_shop(tmp_path / "d", runs=5)))
    worth = {w.name: w for w in found.sensors}
    assert min(worth, key=lambda name: worth[name].alone_um) in ("spindle", "twin")
    assert worth["idle"].alone_um > 5.0 * worth["spindle"].alone_um
    assert abs(found.more(worth["idle"].without_um)) < 0.1
    assert [group.sensors for group in found.groups] == [("spindle", "twin")]
    assert found.groups[0].without_um > 5.0 * worth["spindle"].without_um
    assert len(found.sizes) == 5
    assert found.sizes[-1].sensors == ("spindle", "ambient", "twin", "idle")
    assert found.sizes[0].left_um == found.channels_um
    assert set(found.best.sensors) & {"spindle", "twin"}
    assert "idle" not in found.best.sensors


def test_losses_order_the_sets_and_the_small_one_keeps_its_promise(tmp_path: Path) -> None:
    data = load_dataset(write_shop(tmp_path / "d", runs=5))
    inputs, splits = Inputs(data, tip_metric(data), Settings()), folds(data)
    sizes = []
    for loss in (0.0, 0.05, 0.5, 1.0):
        found = select(inputs, splits, loss)
        assert found.best.fair_um is not None
        assert found.best.fair_um <= (1.0 + loss) * found.all_um * (1.0 + 1e-9)
        sizes.append(len(found.best.sensors))
    assert sizes == sorted(sizes, reverse=True)


def test_what_a_set_is_judged_by_fairly_has_no_part_in_choosing_it(tmp_path: Path) -> None:
    """Of sensors that the drift does not follow, the best by chance is no good on what did not choose it."""
    data = load_dataset(write_shop(tmp_path / "d", runs=6))
    rng = np.random.default_rng(1)
    count = 10
    runs = {
        name: replace(
            run,
            telemetry=replace(
                run.telemetry,
                temperatures=20.0 + np.cumsum(rng.normal(0, 0.3, (len(run.telemetry.time_s), count)), axis=0),
                channels=np.zeros((len(run.telemetry.time_s), 0)),
            ),
        )
        for name, run in data.runs.items()
    }
    found = selected(replace(data, sensors=tuple(f"s{i}" for i in range(count)), channels=(), runs=runs))
    lucky = [size for size in found.sizes if size.by == "drift" and 0 < len(size.sensors) < count]
    assert all(size.fair_um is not None for size in lucky)
    best = min(step.left_um for step in (*found.backward, *found.forward))
    fair = min(size.fair_um for size in found.sizes if size.sensors)  # type: ignore[type-var]
    assert best < fair  # type: ignore[operator]
    assert not found.channels


def test_the_others_tell_a_combination_and_not_the_independent_one() -> None:
    rng = np.random.default_rng(0)
    a, b, c = np.cumsum(rng.normal(0, 1.0, (3, 2000)), axis=1)
    steps = told_best([np.stack([a, b, (a + b) / 2.0, 3.0 * c], axis=1)])
    assert steps[0][0] in (0, 1, 2)  # any of the three is told exactly by the other two
    assert 3 in steps[1][1]
    assert steps[0][1] == frozenset(range(4)) - {steps[0][0]}
    assert [len(kept) for _, kept in steps] == [3, 2, 1, 0]


def test_groups_are_of_sensors_that_all_go_together() -> None:
    rng = np.random.default_rng(0)
    a, b = np.cumsum(rng.normal(0, 1.0, (2, 2000)), axis=1)
    b -= a * (a @ b) / (a @ a)
    # The third lies between the first and the last: like either, while these two are not alike.
    readings = [np.stack([a, np.zeros(2000), a + 100.0, -a, b], axis=1)]
    assert [sorted(group) for group, _ in alike(readings)] == [[0, 2]]
    assert alike([np.zeros((5, 3))]) == []


def test_folds_leave_out_everything_once_and_nothing_twice(tmp_path: Path) -> None:
    for runs in (1, 2, 7):
        data = load_dataset(write_shop(tmp_path / f"d{runs}", runs=runs, hours=12.0))
        splits = folds(data)
        assert len(splits) >= 2
        for name in data.runs:
            np.testing.assert_array_equal(sum(s.test[name].astype(int) for s in splits), 1)
            assert all((s.train[name] != s.test[name]).all() for s in splits)
    data.runs.clear()
    run = load_dataset(tmp_path / "d1").runs["r0"]
    data.runs["r0"] = replace(run, time_s=run.time_s[:1], values=run.values[:1])
    with pytest.raises(DataError, match="run 'r0' of '.*' cannot be divided in time; record more than one run"):
        folds(data)


def test_nothing_that_moves_is_said(tmp_path: Path) -> None:
    data = load_dataset(write_shop(tmp_path / "d"))
    for run in data.runs.values():
        run.values[:] = 0.0
    with pytest.raises(DataError, match="data set '.*' must have measurements in which the tool tip moves, got none"):
        selected(data)


def write_touches(folder: Path, places: int) -> Path:
    """Replace the error terms by the tip's deviation at two positions, of so many."""
    data = load_dataset(folder)
    chain, machine = Chain(data.machine), data.machine
    rng = np.random.default_rng(3)
    low, high = ([getattr(machine.axes[a], e) for a in machine.axis_names] for e in ("low", "high"))
    where = rng.uniform(low, high, (places, len(low)))
    table: dict[str, list[float] | list[str]] = {
        c: [] for c in ("run", "time_s", *machine.axis_names, "dx_um", "dy_um", "dz_um")
    }
    for name, run in data.runs.items():
        for time_s, values in zip(run.time_s, run.values, strict=True):
            for q in where[rng.choice(places, 2, replace=False)] if places > 2 else where:
                effect = chain.sensitivity(q[None])[0, :3]
                exx, ez0t = values[2] * q[machine.axis_names.index("X")] / 800.0, values[3]
                um = sum(
                    effect[:, machine.term_index[t]] * machine.term(t).to_internal / UM * v
                    for t, v in (("EXX", exx), ("EZ0T", ez0t))
                )
                for column, cell in zip(table, (name, time_s, *q, *um), strict=True):
                    table[column].append(cell)
    (folder / "error_terms.csv").unlink()
    write_table(folder / "tool_tip.csv", table)
    return folder


def test_the_tip_at_repeated_places_judges_sensors_too(tmp_path: Path) -> None:
    by_terms = selected(load_dataset(write_shop(tmp_path / "terms")))
    found = selected(load_dataset(write_touches(write_shop(tmp_path / "tip"), places=2)))
    shares = [
        [w.without_um / s.all_um for w in s.sensors] + [s.all_um / s.drift_um, s.channels_um / s.drift_um]
        for s in (by_terms, found)
    ]
    np.testing.assert_allclose(*shares, rtol=0.1)
    data = load_dataset(write_touches(write_shop(tmp_path / "anew"), places=500))
    with pytest.raises(DataError, match="tool_tip of data set '.*' must repeat its positions for sensors to be judged"):
        Inputs(data, tip_metric(data), Settings())


def run_cli(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from model.cli import main; main()", "sensors", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_command_prints_tables_json_and_a_picture(tmp_path: Path) -> None:
    folder = write_shop(tmp_path / "d")
    done = run_cli(folder, "--plot", tmp_path / "sensors.png")
    assert done.stderr == ""
    assert done.returncode == 0
    assert "interchangeable: spindle, twin" in done.stdout
    assert "smallest set within 10% of all" in done.stdout
    assert (tmp_path / "sensors.png").stat().st_size > 10_000
    done = run_cli(folder, "--json", "--loss", "0.5")
    found = json.loads(done.stdout)
    assert found["loss"] == 0.5
    assert [size["fair_um"] for size in found["sizes"]][-1] == pytest.approx(found["all_um"], rel=1e-9)
    assert {w["name"] for w in found["sensors"]} == {"spindle", "ambient", "twin", "idle"}
    assert set(found["instead"]) == set(found["best"]["sensors"])


def test_two_runs_are_too_few_to_choose_fairly(tmp_path: Path) -> None:
    done = run_cli(write_shop(tmp_path / "d", runs=2))
    assert done.returncode == 0
    assert "note: with two parts to leave out the sets are judged by what chose them" in done.stderr


@pytest.mark.parametrize("loss", ["much", "-5%", "10", "nan", "%"])
def test_a_loss_that_is_none_is_refused(tmp_path: Path, loss: str) -> None:
    done = run_cli(tmp_path, "--loss", loss)
    assert done.returncode == 2
    assert f"must be a share from 0 to 100% such as 10% or 0.1, got '{loss}'" in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_data_set_without_sensors_and_a_bad_picture_are_refused(tmp_path: Path) -> None:
    folder = write_shop(tmp_path / "d")
    done = run_cli(folder, "--plot", tmp_path / "sensors.txt")
    assert done.returncode == 2
    assert "must end in .png, .svg, .pdf, got '.txt'" in done.stderr
    text = (folder / "machine.toml").read_text()
    (folder / "machine.toml").write_text(re.sub(r"(?m)^\[sensors.*\n(?:[^\[\n].*\n|\n)*", "", text))
    done = run_cli(folder)
    assert done.returncode == 2
    assert "machine.toml must describe its sensors" in done.stderr
