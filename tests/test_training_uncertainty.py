"""The network knows how far off it may be: by laws, on data whose noise is known."""

import json
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from bundles import edit
from shop import touch, write_dataset

from model.bundle import load_bundle
from model.chain import Chain
from model.exceptions import BundleError
from model.fields import Fields
from model.manifest import UncertaintyRecord
from model.network import ThermalNetwork
from model.predictor import Predictor
from model.sensors import SensorModel
from model.tables import read_table, write_table
from model.terms import UM
from model.transforms import Array
from model.uncertainty import Uncertainty
from training.dataset import MeasuredRun, load_dataset
from training.interval import Interval, interval
from training.job import Result, evaluate_bundle, train_bundle
from training.samples import collect
from training.split import split_by_run
from training.tip import tip_metric
from training.tip_methods import measured_as
from training.trainer import Settings, Verdict, train_network
from training.uncertainty import estimate, fit_line, scaled_modes, widening

THERMOTRUE = str(Path(sys.executable).with_name("thermotrue"))
TINY = Path(__file__).parent / "data" / "tiny_bundle"
SETTINGS = Settings()


def noisy(folder: Path, noise_um: float, runs: int = 12, *, datum: str = "absolute", seed: int = 0) -> Path:
    """Write the shop's data set, and give the holder's growth and the X axis' stretch a noise of their own."""
    write_dataset(folder, runs, 3.0, datum=datum)
    table = read_table(folder / "error_terms.csv", text=("run", "term"))
    rng = np.random.default_rng(seed)
    holder = table.text["term"] == "EZ0T"
    time = np.cumsum(holder) - 1  # the holder's row is the first of each time
    noise = noise_um * rng.normal(size=(2, time[-1] + 1))[:, time]
    value = table.numbers["value"] + np.where(holder, noise[0], noise[1] * (0.5 + table.numbers["position"] / 800.0))
    columns = {"run": table.text["run"], "time_s": table.numbers["time_s"], "term": table.text["term"]}
    positions = ["" if np.isnan(p) else f"{p:g}" for p in table.numbers["position"]]
    write_table(folder / "error_terms.csv", {**columns, "position": positions, "value": value})
    return folder


@dataclass(frozen=True)
class Known:
    """A linear decoder and what it knows of itself; modes of its training and how its interval did on other runs."""

    record: UncertaintyRecord
    uncertainty: Uncertainty
    modes: Array
    did: Interval


def known(path: Path, test_runs: list[str]) -> Known:
    data = load_dataset(path)
    metric, split = tip_metric(data), split_by_run(data, test_runs)
    sensors = SensorModel.fit(np.concatenate([data.runs[n].telemetry.temperatures for n in split.train_runs]))
    made = train_network(data, split, metric, sensors, SETTINGS, Verdict(False, 0.0, 0.0))
    net: ThermalNetwork = made.net
    fields: Fields = made.fields
    settings = {"ridge": SETTINGS.ridge, "correlation_s": SETTINGS.correlation_s}
    record = estimate(data, split, metric, net, fields, sensors, made.solve, **settings)
    assert record is not None
    uncertainty = Uncertainty(fields, record, net.modes)
    all_of = {name: {name: np.ones(len(run.time_s), dtype=bool)} for name, run in data.runs.items()}
    features = {n: collect(net, data, m, metric.coverage, fields, sensors).features for n, m in all_of.items()}
    weights, bias = net.linear.detach().numpy(), net.bias.detach().numpy()

    def predict(run: MeasuredRun) -> Array:
        return measured_as(data, metric, fields, run, features[run.telemetry.name] @ weights + bias)

    def spread(run: MeasuredRun) -> Array:
        return uncertainty.size_of(scaled_modes(net, features[run.telemetry.name]))

    did = interval(data, split.test, predict, spread, uncertainty, metric)
    return Known(record, uncertainty, scaled_modes(net, np.concatenate([features[n] for n in split.train_runs])), did)


TESTED = [f"r{i}" for i in range(8, 12)]


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Known:
    return known(noisy(tmp_path_factory.mktemp("small") / "data", 3.0), TESTED)


@pytest.mark.parametrize("datum", ["absolute", "run-start"])
def test_the_interval_covers_what_it_says(tmp_path: Path, datum: str) -> None:
    found = known(noisy(tmp_path / "data", 3.0, datum=datum), TESTED)
    assert 0.92 <= found.did.within <= 0.99
    assert list(found.did.by_run) == TESTED
    assert found.record.parts == 8


def test_the_standard_deviation_is_that_of_the_noise_and_grows_with_it(tmp_path: Path, small: Known) -> None:
    where = small.uncertainty.fields.slices()["EZ0T"]
    usual = small.uncertainty.coefficients(small.uncertainty.size_of(small.modes)).mean(axis=0)[where][0]
    assert 3.0 < usual < 1.5 * 3.0
    large = known(noisy(tmp_path / "data", 9.0), TESTED)
    assert large.did.half_width_um == pytest.approx(3.0 * small.did.half_width_um, rel=0.15)


def test_it_is_less_sure_outside_of_what_it_was_trained_on(small: Known) -> None:
    sizes = [small.uncertainty.size_of(k * small.modes).mean() for k in (0.0, 1.0, 3.0, 10.0, 30.0)]
    assert np.all(np.diff(sizes) > 0.0)
    assert sizes[-1] > 3.0 * sizes[1]


def test_few_runs_make_it_careful(tmp_path: Path, small: Known) -> None:
    few = known(noisy(tmp_path / "data", 3.0, 4), ["r3"])
    assert few.record.parts == 3
    assert few.did.half_width_um > 1.5 * small.did.half_width_um
    assert few.did.within > 0.96
    one = known(noisy(tmp_path / "one", 3.0, 2), ["r1"])
    assert one.record.data == "5 parts of run r0, left out in turn"
    assert one.did.within > 0.95


def test_widening_falls_towards_one() -> None:
    wider = [widening(n) for n in (2, 3, 5, 10, 30, 1000)]
    assert np.all(np.diff(wider) < 0.0)
    assert wider[-1] == pytest.approx(1.0, abs=0.002)
    assert wider[0] == pytest.approx(12.706 / 1.96, rel=1e-3)  # Student's t of one degree of freedom, in any table


def test_a_line_is_found_again_from_squares_of_normal_numbers() -> None:
    rng = np.random.default_rng(2)
    leverage = rng.exponential(4.0, 20_000)
    floor, rise = fit_line(leverage, (0.5 + 0.3 * leverage) * rng.normal(size=20_000) ** 2)
    assert floor == pytest.approx(0.5, rel=0.1)
    assert rise == pytest.approx(0.3, rel=0.1)
    flat = fit_line(leverage, 2.0 * rng.normal(size=20_000) ** 2)
    assert flat[0] + 4.0 * flat[1] == pytest.approx(2.0, rel=0.05)


def test_the_few_directions_stored_give_the_leverage_of_ridge_regression(small: Known) -> None:
    z, ridge = small.modes, SETTINGS.ridge
    exact = ridge * ((z @ np.linalg.inv(z.T @ z / len(z) + ridge * np.eye(z.shape[1]))) * z).sum(axis=1)
    found = (small.uncertainty.size_of(z) ** 2 - small.record.floor) / small.record.rise
    assert np.all(found > exact * 0.999)  # what is left out counts as not seen
    np.testing.assert_allclose(found.mean(), exact.mean(), rtol=0.03)


def test_the_tips_standard_deviation_is_that_of_drawn_coefficients(small: Known) -> None:
    rng = np.random.default_rng(4)
    fields, directions = small.uncertainty.fields, small.uncertainty.directions
    chain = Chain(fields.machine)
    q = np.array([[700.0, 100.0, 50.0], [100.0, -200.0, 400.0]])
    drawn = rng.normal(size=(4000, len(directions))) @ directions
    for i, at in enumerate(q):
        many = np.tile(at, (len(drawn), 1))
        tip = chain.deviation(many, fields.evaluate(drawn, many)).position_mm / UM
        np.testing.assert_allclose(small.uncertainty.usual_tip(q)[i], tip.std(axis=0), rtol=0.05, atol=1e-6)
        whole = np.hypot(2.0 * tip.std(axis=0), small.record.misfit_um)
        np.testing.assert_allclose(small.uncertainty.tip(q, np.full(2, 2.0))[i], whole, rtol=0.05, atol=1e-6)
        terms = small.uncertainty.terms(q, np.full(2, 2.0))[i]
        np.testing.assert_allclose(terms, 2.0 * fields.evaluate(drawn, many).std(axis=0), rtol=0.05, atol=1e-12)


def test_a_measured_tip_is_covered_too(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "data", 8, 3.0)
    touch(folder, 4, again=True, noise_um=2.0)
    (folder / "error_terms.csv").unlink()
    found = known(folder, ["r6", "r7"])
    assert found.did.within > 0.9
    assert found.did.half_width_um < 15.0


def test_what_does_not_fit_the_network_is_refused(small: Known) -> None:
    wrong = small.record.model_copy(update={"directions": [[1.0]]})
    with pytest.raises(BundleError, match="uncertainty in the manifest must be of"):
        Uncertainty(small.uncertainty.fields, wrong, small.modes.shape[1])


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Result:
    folder = tmp_path_factory.mktemp("trained")
    return train_bundle(noisy(folder / "data", 3.0), folder / "bundle", TESTED, 0)


def test_the_bundle_says_it_and_evaluate_measures_it(trained: Result) -> None:
    assert trained.interval is not None
    assert trained.bundle.manifest.test["interval"] == trained.interval.as_dict()
    again = evaluate_bundle(trained.bundle.path, trained.dataset.path, TESTED)
    assert again.interval == trained.interval
    assert 0.92 <= trained.interval.within <= 0.99
    record = load_bundle(trained.bundle.path).manifest.network
    assert record is not None
    assert record.uncertainty is not None
    assert UncertaintyRecord.model_validate_json(record.uncertainty.model_dump_json()) == record.uncertainty


def run(*args: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([THERMOTRUE, *map(str, args)], capture_output=True, text=True, check=False)


def test_an_older_bundle_is_used_without(trained: Result, tmp_path: Path) -> None:
    old = Path(shutil.copytree(trained.bundle.path, tmp_path / "old"))
    edit(old, lambda m: m["network"].pop("uncertainty"))
    said = run("evaluate", old, trained.dataset.path, "--json")
    assert said.returncode == 0, said.stderr
    assert "interval" not in json.loads(said.stdout)
    assert "interval" not in run("evaluate", old, trained.dataset.path, "--runs", "r9").stdout
    now = run("evaluate", trained.bundle.path, trained.dataset.path, "--runs", "r9")
    assert "the network's 95 % interval at the tip" in now.stdout
    predictor = Predictor(load_bundle(TINY))
    assert predictor.uncertainty is None
    with pytest.raises(BundleError, match="bundle must say how far predictions may be off"):
        predictor.spread([])


def test_predict_adds_standard_deviations_where_they_are_asked_for(trained: Result, tmp_path: Path) -> None:
    q = np.array([[10.0, 0.0, 0.0], [790.0, 0.0, 0.0], [790.0, 100.0, 300.0]])
    columns = {"run": ["r9"] * 3, "time_s": [0.0, 3600.0, 10000.0], **dict(zip("XYZ", q.T, strict=True))}
    write_table(tmp_path / "positions.csv", columns)
    telemetry = trained.dataset.path / "telemetry.csv"
    args = ("predict", trained.bundle.path, telemetry, "--positions", tmp_path / "positions.csv", "--out")
    for option in ((), ("--uncertainty",)):
        done = run(*args, tmp_path / f"out{len(option)}.csv", *option)
        assert done.returncode == 0, done.stderr
    plain, more = (read_table(tmp_path / f"out{k}.csv") for k in (0, 1))
    assert list(plain.numbers) == ["time_s", "X", "Y", "Z", "dx_um", "dy_um", "dz_um"]
    assert list(more.numbers) == [*plain.numbers, "dx_std_um", "dy_std_um", "dz_std_um"]
    for name, values in plain.numbers.items():
        np.testing.assert_array_equal(values, more.numbers[name])
    predictor = Predictor(trained.bundle)
    assert predictor.uncertainty is not None
    telemetry_run = trained.dataset.runs["r9"].telemetry
    spread = predictor.spread(predictor.states(telemetry_run))
    size = np.interp(plain.numbers["time_s"], telemetry_run.time_s, spread)
    expected = predictor.uncertainty.tip(q, size)[:, 2]
    np.testing.assert_allclose(more.numbers["dz_std_um"], expected, rtol=1e-6)
    assert np.all(expected > 3.0)

    table = (TINY, telemetry, "--positions", tmp_path / "positions.csv", "--out", tmp_path / "no.csv")
    done = run("predict", *table, "--uncertainty")
    assert done.returncode == 2
    assert done.stderr.startswith(f"thermotrue: bundle '{TINY}' must say how far it may be off for --uncertainty")
