"""Training on tool-tip deviations, alone and beside error terms, on a machine whose truth is known."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from machines import FIVE_AXIS, five_axis_text
from shop import tip_truth, touch, write_dataset

from model.chain import Chain
from model.exceptions import DataError, InputError
from model.fields import Fields
from model.machine import load_machine
from model.predictor import Predictor
from model.sensors import SensorModel
from model.tables import read_table, write_table
from model.tip_effects import tip_effects
from training.dataset import DataSet, load_dataset
from training.decoder import kept, solve_decoder
from training.effects import volume_form
from training.evaluation import NETWORK, NO_COMPENSATION, RIDGE, compare
from training.information import Directions, Information, gather
from training.job import train_bundle
from training.samples import Samples
from training.split import Split, split_by_run
from training.tip import tip_metric
from training.tip_decoder import Smoother, solve_weights
from training.tip_methods import identify, measured_as
from training.trainer import Settings, Training, Verdict, train_network
from training.volume import volume_grid

THERMOTRUE = str(Path(sys.executable).with_name("thermotrue"))
TOOL_SIDE, WORK_SIDE = "w Y b X Z t", "w X Y b Z t"
RUNS, HOURS = 5, 4.0


def trained(folder: Path, test: str = "r4") -> tuple[DataSet, Training]:
    """Return the data set and its network, without the nonlinear residual."""
    data = load_dataset(folder)
    split = split_by_run(data, [test]) if test in data.runs else _whole(data)
    sensors = SensorModel.fit(np.concatenate([data.runs[n].telemetry.temperatures for n in split.train_runs]))
    return data, train_network(data, split, tip_metric(data), sensors, Settings(), Verdict(False, 0.0, 0.0))


def _whole(data: DataSet) -> Split:
    everything = {name: np.ones(len(run.time_s), dtype=bool) for name, run in data.runs.items()}
    return Split(everything, {name: ~mask for name, mask in everything.items()}, "nothing")


def left(folder: Path, training: Training, structure: str = WORK_SIDE, test: str = "r4") -> float:
    """Return the share of the tip's true drift over the volume that a network leaves, by the terms' own table."""
    import torch

    telemetry = read_table(folder / "telemetry.csv")
    rows = telemetry.text["run"] == test
    time_s = telemetry.numbers["time_s"][rows]
    raw = np.stack([telemetry.numbers[c][rows] for c in ("spindle", "ambient", "spindle_rpm")], axis=1)
    dt_s = np.diff(time_s, prepend=time_s[0])
    with torch.no_grad():
        net = training.net
        c = net.decode(net.sequence(torch.tensor(raw[None]), torch.tensor(dt_s[None])))[0].numpy()
    table = read_table(folder / "error_terms.csv", text=("run", "term"))
    z = (table.text["run"] == test) & (table.text["term"] == "EZ0T")
    felt = -table.numbers["value"][z] / 5.0
    c = c[np.searchsorted(time_s, table.numbers["time_s"][z])]
    if "run-start" in (folder / "dataset.toml").read_text():
        c = c - c[0]
    q = volume_grid(training.fields.machine)
    said = np.einsum("qdp,np->nqd", tip_effects(training.fields, q), c)
    true = np.stack([tip_truth(felt, np.full(len(felt), at[0]), structure) for at in q], axis=1)
    return float(np.sqrt(((said - true) ** 2).sum() / (true**2).sum()))


def without(folder: Path, table: str) -> Path:
    (folder / table).rename(folder / f"{table}.aside")
    return folder


def back(folder: Path, table: str) -> Path:
    (folder / f"{table}.aside").rename(folder / table)
    return folder


@pytest.mark.parametrize("structure", [TOOL_SIDE, WORK_SIDE])
@pytest.mark.parametrize("datum", ["absolute", "run-start"])
@pytest.mark.parametrize("again", [True, False])
def test_a_network_learns_from_the_tip_alone_on_both_sides_of_the_bed(
    tmp_path: Path, structure: str, datum: str, again: bool
) -> None:
    """A wrong sign of the axis would leave more than twice its part, most of the drift."""
    folder = write_dataset(tmp_path / "d", RUNS, HOURS, datum=datum, structure=structure)
    touch(folder, 8, again=again, noise_um=0.5, structure=structure)
    data, by_tip = trained(without(folder, "error_terms.csv"))
    assert data.columns == ()
    assert data.places == 8
    assert left(back(folder, "error_terms.csv"), by_tip, structure) < (0.12 if datum == "absolute" else 0.25)


def test_the_tip_alone_comes_near_the_terms_themselves(tmp_path: Path) -> None:
    folder = touch(write_dataset(tmp_path / "d", RUNS, HOURS), 8, noise_um=0.1)
    _, by_terms = trained(without(folder, "tool_tip.csv"))
    back(folder, "tool_tip.csv")
    _, by_tip = trained(without(folder, "error_terms.csv"))
    back(folder, "error_terms.csv")
    assert left(folder, by_tip) < 1.5 * left(folder, by_terms)


def test_all_terms_of_some_runs_and_tips_of_others_are_better_than_either(tmp_path: Path) -> None:
    found: dict[str, list[float]] = {"terms": [], "tip": [], "both": []}
    for seed in range(4):
        folder = touch(write_dataset(tmp_path / str(seed), RUNS, HOURS, seed=seed), 2, runs=("r2", "r3"))
        whole = (folder / "error_terms.csv").read_text()
        some = all_terms_of(folder, ("r0", "r1"))
        for name, runs in (("terms", {"r0", "r1"}), ("both", {"r0", "r1", "r2", "r3"}), ("tip", {"r2", "r3"})):
            if name == "terms":
                without(folder, "tool_tip.csv")
            (folder / "error_terms.csv").write_text(some)
            if name == "tip":
                (folder / "error_terms.csv").unlink()
            data, training = trained(folder, "none")
            assert set(data.runs) == runs
            if name == "terms":
                back(folder, "tool_tip.csv")
            (folder / "error_terms.csv").write_text(whole)
            found[name].append(left(folder, training))
    rms = {name: float(np.sqrt(np.mean(np.square(shares)))) for name, shares in found.items()}
    assert rms["both"] <= min(rms["terms"], rms["tip"])


def all_terms_of(folder: Path, runs: tuple[str, ...]) -> str:
    """Return the table of error terms for some runs, with the terms that do not move as well."""
    machine = load_machine(folder)
    rows = (folder / "error_terms.csv").read_text().splitlines()
    some = [rows[0], *(row for row in rows[1:] if row.startswith(runs))]
    for run, time_s in dict.fromkeys(tuple(row.split(",")[:2]) for row in some[1:]):
        for term in machine.terms:
            if term.name not in {"EXX", "EZ0T"}:
                axis = None if term.kind == "location" else machine.axes[term.axis]
                some += [f"{run},{time_s},{term.name},{p},0" for p in ([""] if axis is None else [axis.low, axis.high])]
    return "\n".join(some) + "\n"


def test_one_measured_term_and_the_tip_agree(tmp_path: Path) -> None:
    """EZ0T alone leaves X to the tip, which was measured at a single place and so does not know how X runs."""
    folder = touch(write_dataset(tmp_path / "d", RUNS, HOURS), 1, again=True)
    rows = (folder / "error_terms.csv").read_text().splitlines()
    found = {}
    for name, term in (("tip and X", "EXX"), ("tip and Z", "EZ0T")):
        (folder / "error_terms.csv").write_text("\n".join([rows[0], *(r for r in rows if f",{term}," in r)]) + "\n")
        data, training = trained(folder)
        assert (data.measured_terms, data.places) == ((term,), 1)
        (folder / "error_terms.csv").write_text("\n".join(rows) + "\n")
        found[name] = left(folder, training)
    assert found["tip and X"] < 0.1 < found["tip and Z"]


def test_coefficients_move_the_tip_as_the_chain_does() -> None:
    rng = np.random.default_rng(3)
    for structure in FIVE_AXIS:
        machine = load_text(five_axis_text(structure))
        fields = Fields(machine, tuple(t.name for t in machine.terms), 3)
        q = rng.uniform([a.low for a in machine.axes.values()], [a.high for a in machine.axes.values()], (20, 5))
        c = rng.normal(0.0, 0.01, fields.size)
        exact = 1e3 * Chain(machine).deviation(q, fields.evaluate(np.tile(c, (20, 1)), q)).position_mm
        np.testing.assert_allclose(tip_effects(fields, q) @ c, exact, atol=1e-5 * np.abs(exact).max())


def load_text(text: str):  # type: ignore[no-untyped-def]
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "machine.toml"
        path.write_text(text)
        return load_machine(path)


def machine_and_fields(tmp_path: Path) -> Fields:
    machine = load_dataset(write_dataset(tmp_path / "m", 1, 1.0)).machine
    return Fields(machine, tuple(t.name for t in machine.terms), 3)


def test_the_directions_hold_all_that_the_tip_sees_and_nothing_else(tmp_path: Path) -> None:
    fields = machine_and_fields(tmp_path)
    directions = Directions.of(fields)
    np.testing.assert_allclose(directions.seen.T @ directions.seen, np.eye(directions.seen.shape[1]), atol=1e-9)
    form = volume_form(fields)
    rng = np.random.default_rng(0)
    c = rng.normal(size=(50, fields.size))
    unseen = directions.unseen(c)
    energy = lambda rows: np.einsum("ni,ij,nj->n", rows, form, rows)  # noqa: E731
    assert (energy(unseen) < 1e-2 * energy(c)).all()
    np.testing.assert_allclose(directions.unseen(unseen), unseen, atol=1e-9)
    weights = rng.normal(size=(4, directions.seen.shape[1]))
    np.testing.assert_allclose(directions.unseen(directions.coefficients(weights)), 0.0, atol=1e-9)
    assert directions.seen.shape[1] < fields.size / 2


def dense(keep: np.ndarray, precision: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return T and N of one run as full matrices, from the process' covariance."""
    n, r = len(keep), precision.shape[1]
    log = np.cumsum(np.log(np.where(keep > 0, keep, 1.0)))
    covariance = np.exp(-np.abs(log[:, None] - log))
    full = np.zeros((n * r, n * r))
    for t in range(n):
        full[t * r : (t + 1) * r, t * r : (t + 1) * r] = precision[t]
    return np.kron(np.linalg.inv(covariance), np.eye(r)), full


def test_the_smoother_is_the_inverse_of_the_whole_matrix() -> None:
    rng = np.random.default_rng(5)
    lengths, r = (7, 1, 4), 3
    run = np.repeat(np.arange(3), lengths)
    time_s = np.concatenate([np.cumsum(rng.uniform(50.0, 2000.0, n)) for n in lengths])
    keep = kept(time_s, run, 900.0)
    rows = rng.normal(size=(len(run), 2, r)) * (rng.uniform(size=(len(run), 1, 1)) > 0.3)
    precision = np.einsum("nki,nkj->nij", rows, rows)
    process = Smoother(keep, run, precision)
    z = rng.normal(size=(len(run), r))
    for k in range(3):
        own = run == k
        t, n = dense(keep[own], precision[own])
        flat = z[own].ravel()
        np.testing.assert_allclose(process.precise(z)[own].ravel(), t @ flat, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(process.smooth(z)[own].ravel(), np.linalg.solve(t + n, flat), rtol=1e-9, atol=1e-12)
        expected = (t - t @ np.linalg.solve(t + n, t)) @ flat
        np.testing.assert_allclose(process.information(z)[own].ravel(), expected, rtol=1e-8, atol=1e-10)


def test_where_all_is_known_the_decoder_is_the_plain_ridge_regression() -> None:
    rng = np.random.default_rng(6)
    run = np.repeat(np.arange(3), 40)
    time_s = np.tile(np.arange(40) * 300.0, 3)
    x, z = rng.normal(size=(120, 8)), rng.normal(size=(120, 4))
    samples = Samples(x, 0.0 * x, z, run, time_s)
    plain, _ = solve_decoder(samples, ridge=0.1, correlation_s=900.0, bias=False)
    keep = kept(time_s, run, 900.0)
    sure = 1e7
    directions = Directions(np.ones(4), np.eye(4))
    information = Information(directions, np.tile(sure * np.eye(4), (120, 1, 1)), sure * z)
    effective = float(((1.0 - keep) / (1.0 + keep)).sum())
    weights = solve_weights(x, information, keep, run, 0.1 * effective)
    np.testing.assert_allclose(weights, plain, atol=1e-5 * np.abs(plain).max())
    both, _ = solve_decoder(replace(samples, information=information), ridge=0.1, correlation_s=900.0, bias=False)
    np.testing.assert_allclose(both, plain, atol=1e-5 * np.abs(plain).max())


def test_the_equations_are_solved_whatever_the_places(tmp_path: Path) -> None:
    """Conjugate gradients against the dense normal equations of the joint regression."""
    fields = machine_and_fields(tmp_path)
    rng = np.random.default_rng(7)
    q = rng.uniform([0.0, -250.0, 0.0], [800.0, 250.0, 500.0], (30, 2, 3))
    deviation = rng.normal(size=(30, 2, 3))
    deviation[::3, 1] = np.nan
    deviation[5, 0, 2] = np.nan
    information = gather(fields, np.full((30, fields.size), np.nan), q, deviation)
    assert information is not None
    x, run = rng.normal(size=(30, 3)), np.repeat([0, 1], 15)
    keep = kept(np.tile(np.arange(15) * 300.0, 2), run, 900.0)
    found = solve_weights(x, information, keep, run, 2.0)
    r = found.shape[1]
    normal, wanted = np.zeros((3 * r, 3 * r)), np.zeros(3 * r)
    for k in (0, 1):
        own = run == k
        t, n = dense(keep[own], information.precision[own])
        features = np.kron(x[own], np.eye(r))
        normal += features.T @ (t - t @ np.linalg.solve(t + n, t)) @ features
        wanted += features.T @ t @ np.linalg.solve(t + n, information.vector[own].ravel())
    expected = np.linalg.solve(normal + 2.0 * np.eye(3 * r), wanted).reshape(3, r)
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


def test_the_cold_machine_is_taken_out_of_absolute_deviations(tmp_path: Path) -> None:
    folder = without(touch(write_dataset(tmp_path / "d", 2, 2.0), 2), "error_terms.csv")
    plain = load_dataset(folder).runs["r0"]
    (folder / "geometry.csv").write_text("term,position,value\nEYX,0,40\nEYX,800,-40\nEX0T,,25\n")
    table = read_table(folder / "tool_tip.csv")
    # X carries the workpiece, so its straightness moves the tip the other way.
    table.numbers["dy_um"] -= 40.0 - table.numbers["X"] / 10.0
    table.numbers["dx_um"] += 25.0
    write_table(folder / "tool_tip.csv", {"run": table.text["run"].tolist(), **table.numbers})
    np.testing.assert_allclose(load_dataset(folder).runs["r0"].values, plain.values, atol=1e-6)
    (folder / "dataset.toml").write_text('datum = "run-start"\n')
    assert np.nanmax(np.abs(load_dataset(folder).runs["r0"].values - plain.values)) > 20.0


def test_the_tip_is_judged_at_the_measured_places(tmp_path: Path) -> None:
    folder = without(touch(write_dataset(tmp_path / "d", 2, 2.0), 3), "error_terms.csv")
    data = load_dataset(folder)
    metric = tip_metric(data)
    everything = {name: np.ones(len(run.time_s), dtype=bool) for name, run in data.runs.items()}
    half = {"half": lambda run: 0.5 * metric.sample(run.values)}
    scores = compare(data, everything, half, metric)
    table = read_table(folder / "tool_tip.csv")
    square = sum(table.numbers[f"d{a}_um"] ** 2 for a in "xyz")
    assert scores[NO_COMPENSATION].rms_um == pytest.approx(np.sqrt(np.mean(square)))
    assert scores["half"].share == pytest.approx(0.5)


def test_a_place_that_was_not_measured_at_a_time_counts_nowhere(tmp_path: Path) -> None:
    folder = without(touch(write_dataset(tmp_path / "d", 2, 2.0), 3, again=True), "error_terms.csv")
    rows = (folder / "tool_tip.csv").read_text().splitlines()
    cells = rows[2].split(",")
    (folder / "tool_tip.csv").write_text("\n".join([rows[0], rows[1], ",".join([*cells[:-1], ""]), *rows[4:]]) + "\n")
    run = load_dataset(folder).runs["r0"]
    assert np.isfinite(run.values[0]).sum() == 5
    assert np.isfinite(run.values[1:]).all()
    metric = tip_metric(load_dataset(folder))
    known = run.values[0][np.isfinite(run.values[0])]
    assert metric.mean_square(metric.sample(run.values[:1]))[0] == pytest.approx(3.0 * (known**2).mean())


def test_tips_beside_all_terms_say_nothing_new(tmp_path: Path) -> None:
    """Every time has all terms that move the tip, so the data set is one of terms."""
    folder = write_dataset(tmp_path / "d", 2, 2.0)
    text = (folder / "machine.toml").read_text().replace("errors = true", "errors = false")
    (folder / "machine.toml").write_text(text)
    machine = load_machine(folder)
    axes = {a: (axis.low, axis.high) for a, axis in machine.axes.items()}
    rows = ["run,time_s,term,position,value"]
    for t in (0, 600, 1200):
        for term in machine.terms:
            for p in [""] if term.kind == "location" else axes[term.axis]:
                rows.append(f"r0,{t},{term.name},{p},{t / 100}")
    (folder / "tool_tip.csv").write_text("run,time_s,X,Y,Z,dx_um,dy_um,dz_um\nr0,600,0,0,0,1,2,3\n")
    (folder / "error_terms.csv").write_text("\n".join(rows) + "\n")
    data = load_dataset(folder)
    assert (data.places, data.runs["r0"].places) == (0, None)
    assert data.runs["r0"].values.shape[1] == len(data.columns)
    (folder / "tool_tip.csv").write_text("run,time_s,X,Y,Z,dx_um,dy_um,dz_um\nr0,300,0,0,0,1,2,3\n")
    assert load_dataset(folder).places == 1


def test_what_is_identified_from_the_tip_moves_it_as_measured(tmp_path: Path) -> None:
    data = load_dataset(without(touch(write_dataset(tmp_path / "d", 2, HOURS), 3), "error_terms.csv"))
    metric = tip_metric(data)
    fields = Fields(data.machine, data.terms, 3)
    found = identify(data, metric, fields)
    grid = tip_metric(found)
    run = data.runs["r1"]
    q = grid.positions
    felt = -np.nanmean(run.values[:, 2::3], axis=1) / 5.0
    true = np.stack([tip_truth(felt, np.full(len(felt), at[0])) for at in q], axis=1)
    said = grid.deviation(grid.sample(found.runs["r1"].values))
    assert np.sqrt(((said - true) ** 2).sum() / (true**2).sum()) < 0.1
    coefficients = np.zeros((len(run.time_s), fields.size))
    assert np.nansum(measured_as(data, metric, fields, run, coefficients) ** 2) == 0.0


def test_train_and_evaluate_take_the_tip_alone(tmp_path: Path) -> None:
    folder = touch(write_dataset(tmp_path / "d", RUNS, HOURS), 2, noise_um=0.5)
    without(folder, "error_terms.csv")
    result = train_bundle(folder, tmp_path / "bundle", ["r4"], 0)
    assert result.scores[NETWORK].share < 0.15
    assert result.scores[NETWORK].share < 0.7 * result.scores[RIDGE].share
    assert result.bundle.manifest.network is not None
    assert len(result.bundle.manifest.network.terms) > 20
    assert np.isfinite(Predictor(result.bundle).follow(result.dataset.runs["r4"].telemetry)).all()
    done = subprocess.run(
        [
            THERMOTRUE,
            "evaluate",
            tmp_path / "bundle",
            folder,
            "--runs",
            "r4",
            "--json",
            "--picture",
            tmp_path / "p.png",
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["scores"][NETWORK]["rms_um"] == pytest.approx(
        result.scores[NETWORK].rms_um, rel=1e-6
    )
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("dz_um", "dw_um", "'.*tool_tip.csv' must have a column 'dz_um', got"),
        (",Y,", ",A,", "'.*tool_tip.csv' must have a column 'Y', got"),
        ("r0,0.0", "rx,0.0", "'.*tool_tip.csv': run 'rx' must be in the telemetry, got r0"),
        (
            "r0,0.0",
            "r0,1e6",
            r"'.*tool_tip.csv': measurements of run 'r0' must lie within its telemetry, 0 to .* got 1e",
        ),
        ("r0,0.0", "r0,nan", "'.*tool_tip.csv': time_s must be a finite number, got nan in row 1"),
        ("r0,0.0,", "r0,0.0,9", "axis 'X' must lie within 0 and 800 mm, got 9.* in row 1 of '.*tool_tip.csv'"),
    ],
)
def test_a_wrong_table_gets_one_sentence(tmp_path: Path, old: str, new: str, message: str) -> None:
    folder = without(touch(write_dataset(tmp_path / "d", 1, 1.0), 2), "error_terms.csv")
    text = (folder / "tool_tip.csv").read_text()
    assert old in text
    (folder / "tool_tip.csv").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message) as caught:
        load_dataset(folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("", "'.*tool_tip.csv' must have at least one row, got none"),
        ("r0,0,1,2,3,,,\n", "'.*tool_tip.csv' must have a measured value in one of dx_um, dy_um, dz_um, got none"),
        ("r0,0,1,2,3,1,2,2e6\n", r"'.*': dz_um must lie within ±1e\+06 µm, got 2e\+06 in row 1"),
        ("r0,0,1,2,3,1,inf,2\n", r"'.*': dy_um must lie within ±1e\+06 µm, got inf in row 1"),
        (
            "r0,0,1,2,3,1,2,3\nr0,0,1,2,3,1,2,4\n",
            "'.*': the position in row 2 stands twice at time 0 in run 'r0'; keep one",
        ),
        ("r0,0,1,2,3,1,2,3\n", "'.*tool_tip.csv': run 'r0' must have at least two times of measurement, got one"),
    ],
)
def test_measurements_that_cannot_be_get_one_sentence(tmp_path: Path, rows: str, message: str) -> None:
    folder = without(write_dataset(tmp_path / "d", 1, 1.0), "error_terms.csv")
    (folder / "tool_tip.csv").write_text("run,time_s,X,Y,Z,dx_um,dy_um,dz_um\n" + rows)
    with pytest.raises(DataError, match=message) as caught:
        load_dataset(folder)
    assert "\n" not in str(caught.value)
