"""Training learns how lost sensors are told, and how far to rely on it, on data whose truth is known."""

import dataclasses
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from shop import write_dataset

from model.bundle import Bundle
from model.predictor import Predictor, ThermalState
from model.tables import read_table, write_table
from model.telemetry import Run
from model.transforms import Array
from training.dataset import load_dataset
from training.evaluation import NETWORK, NO_COMPENSATION, compare
from training.interval import interval
from training.lost_sensors import learn_lost_sensors
from training.split import Mask, everything, split_by_run
from training.tip import tip_metric
from training.tip_methods import measured_as
from training.trained import Task, Trained
from training.trainer import Settings, Verdict

NAMES = ("spindle", "ambient", "twin")


def with_twin(folder: Path, noise_K: float) -> Path:
    """Write the shop's data set with a third sensor beside the spindle's, that reads 3 K less, and some noise."""
    write_dataset(folder, 6, 4.0)
    machine = folder / "machine.toml"
    machine.write_text(machine.read_text() + "[sensors.twin]\n")
    table = read_table(folder / "telemetry.csv", text=("run",))
    spindle = table.numbers["spindle"]
    twin = spindle - 3.0 + noise_K * np.random.default_rng(1).normal(size=len(spindle))
    write_table(folder / "telemetry.csv", {"run": table.text["run"], **table.numbers, "twin": twin})
    return folder


@dataclass(frozen=True)
class Made:
    """A linear network trained on all runs but two, and its bundle."""

    trained: Trained
    bundle: Bundle

    @property
    def tested(self) -> dict[str, Mask]:
        return self.trained.task.split.test


def made(folder: Path, out: Path, test_runs: list[str]) -> Made:
    data = load_dataset(folder)
    split = split_by_run(data, test_runs) if test_runs else everything(data)
    trained = Trained.of(Task(data, split, tip_metric(data), Settings()), Verdict(False, 0.0, 0.0))
    return Made(trained, trained.write(out, settling_s=0.0, test={}))


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("twin")
    return made(with_twin(folder / "d", 0.02), folder / "bundle", ["r4", "r5"])


def losing(run: Run, lost: Sequence[str]) -> Run:
    temperatures = run.temperatures.copy()
    temperatures[:, [NAMES.index(name) for name in lost]] = np.nan
    return dataclasses.replace(run, temperatures=temperatures)


def did(result: Made, *lost: str) -> tuple[float, float, float, float]:
    """Return share of the drift left, share within the 95 % interval, its half width and the last reliability."""
    task = result.trained.task
    predictor, data, metric = Predictor(result.bundle), task.dataset, task.metric
    assert data.sensors == NAMES
    assert predictor.uncertainty is not None
    states = {
        n: predictor.states(losing(data.runs[n].telemetry, lost)) for n in result.tested if result.tested[n].any()
    }

    def coefficients(name: str) -> Array:
        return np.array([state.coefficients for state in states[name]])

    def method(run):  # type: ignore[no-untyped-def]
        return measured_as(data, metric, predictor.fields, run, run.between(coefficients(run.telemetry.name)))

    scores = compare(data, result.tested, {NETWORK: method}, metric)
    found = interval(
        data,
        result.tested,
        method,
        lambda run: run.between(predictor.spread(states[run.telemetry.name])),
        predictor.uncertainty,
        metric,
    )
    missed = predictor.missed(states["r4"][-1])
    assert missed is not None
    share = scores[NETWORK].rms_um / scores[NO_COMPENSATION].rms_um
    return share, found.within, found.half_width_um, missed.reliability


def test_a_sensor_with_a_twin_is_not_missed(twin: Made) -> None:
    share, within, width, reliability = did(twin)
    for one in ("spindle", "twin", "ambient"):
        found = did(twin, one)
        assert found[0] < share + 0.02
        assert found[3] > 0.97
        assert found[1] > within - 0.05
        assert width < found[2] < 3.0 * width
    assert share < 0.1
    assert reliability == pytest.approx(1.0, abs=0.03)


def test_what_nothing_tells_is_known_to_be_lost(twin: Made) -> None:
    """Without both sensors of the spindle much of the drift is left, and the bundle says so."""
    share, within, width, reliability = did(twin, "spindle", "twin")
    whole = did(twin)
    assert share > 5.0 * whole[0]
    assert within > whole[1] - 0.05
    assert width > 3.0 * whole[2]
    assert reliability < 1.0 - share**2 + 0.01


def test_reliability_falls_outside_of_what_training_saw(twin: Made) -> None:
    predictor = Predictor(twin.bundle)
    run = twin.trained.task.dataset.runs["r4"].telemetry

    def state(factor: float) -> ThermalState:
        """Return the end of a run whose ambient sensor, which training never saw move, moves by up to 10 K."""
        temperatures = run.temperatures.copy()
        temperatures[:, 1] += factor * np.linspace(0.0, 10.0, len(temperatures))
        return predictor.states(dataclasses.replace(run, temperatures=temperatures))[-1]

    found = [predictor.missed(state(factor)) for factor in (0.0, 1.0, 3.0, 10.0)]
    known = [m for m in found if m is not None]
    assert [m.beyond_um for m in known] == sorted(m.beyond_um for m in known)
    assert known[0].reliability > 0.97
    assert all(0.0 < m.reliability < 0.95 for m in known[1:])


def test_the_manifest_stays_small_and_the_same(twin: Made) -> None:
    record = twin.bundle.manifest.network
    assert record is not None
    assert record.lost_sensors is not None
    factors = np.array(record.lost_sensors.factors)
    assert factors.shape[0] <= factors.shape[1]
    assert len(json.dumps(record.lost_sensors.model_dump(mode="json"))) < 50_000
    assert all(m >= tau for m, tau in zip(record.lost_sensors.memory_s[1:], record.time_constants_s, strict=True))
    task, training = twin.trained.task, twin.trained.training
    again = learn_lost_sensors(
        task.dataset,
        task.split,
        task.metric,
        training.net,
        training.fields,
        twin.trained.sensor_model,
    )
    assert again == record.lost_sensors


def test_a_sensor_that_never_moves_and_a_single_short_run_are_no_trouble(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "d", 1, 1.0, datum="run-start")
    predictor = Predictor(made(folder, tmp_path / "bundle", []).bundle)
    run = load_dataset(folder).runs["r0"].telemetry
    for lost in (["ambient"], ["spindle"], ["spindle", "ambient"]):
        states = predictor.states(losing(run, lost))
        assert np.isfinite(states[-1].coefficients).all()
        missed = predictor.missed(states[-1])
        assert missed is not None
        assert 0.0 <= missed.reliability <= 1.0
