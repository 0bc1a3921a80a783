"""From a data set to a bundle, through the command line's own functions."""

import json
import os
import re
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from shop import write_dataset

from model.bundle import load_bundle
from model.cli import main
from model.network import EXPORTER, OPSET
from model.predictor import Predictor
from service.machine_state import MachineState
from service.schemas import Sample
from service.settings import Settings as ServiceSettings
from training.dataset import load_dataset
from training.evaluation import NETWORK, NO_COMPENSATION, RIDGE
from training.fitted import fit_baselines
from training.job import Result, train_bundle
from training.plan import FAST
from training.split import default_split, split_by_run
from training.trainer import Settings

THERMOTRUE = str(Path(sys.executable).with_name("thermotrue"))
ETVE = Path(os.environ.get("THERMOTRUE_ETVE", Path(__file__).parents[2] / "shared" / "data" / "etve"))


@dataclass(frozen=True)
class Done:
    returncode: int
    stdout: str
    stderr: str


Run = Callable[..., Done]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    """Return what runs a command line here, as the installed program does, which first imports for some seconds."""

    def call(*args: object) -> Done:
        monkeypatch.setattr(sys, "argv", [THERMOTRUE, *map(str, args)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as stop:
            main()
        out, err = capfd.readouterr()
        return Done(int(stop.value.code or 0), out, err)

    return call


@pytest.fixture(scope="module")
def trained(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Result:
    return train_bundle(folder, tmp_path_factory.mktemp("trained") / "bundle", ["r4", "r5"], 0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("job") / "data", 6)


def test_the_network_learns_a_lag_that_ridge_cannot_see(trained: Result) -> None:
    assert trained.scores[NETWORK].share < 0.05
    assert trained.scores[NETWORK].share < 0.3 * trained.scores[RIDGE].share
    assert trained.scores[NO_COMPENSATION].share == 1.0
    assert trained.bundle.manifest.training["runs"] == ["r0", "r1", "r2", "r3"]
    assert trained.seen == []
    assert trained.bundle.manifest.network is not None
    assert trained.bundle.manifest.network.datum == "absolute"
    assert (trained.bundle.manifest.network.opset, trained.bundle.manifest.network.exporter) == (OPSET, EXPORTER)
    assert 0.0 <= trained.bundle.manifest.network.settling_time_s < 4 * 3600


def test_one_seed_gives_one_bundle_byte_for_byte(folder: Path, trained: Result, tmp_path: Path) -> None:
    again = train_bundle(folder, tmp_path / "again", ["r4", "r5"], 0)
    assert again.bundle.network == trained.bundle.network
    assert again.bundle.version == trained.bundle.version


def test_by_default_the_bundle_is_trained_on_everything_and_says_so(folder: Path, tmp_path: Path, run: Run) -> None:
    done = run("train", folder, "--out", tmp_path / "bundle", "--picture", tmp_path / "day.png")
    assert done.returncode == 0, done.stderr
    for name in (NO_COMPENSATION, RIDGE, NETWORK):
        assert name in done.stdout
    assert "trained again on everything (6 runs)" in done.stdout
    assert (tmp_path / "day.png").read_bytes().startswith(b"\x89PNG")
    manifest = load_bundle(tmp_path / "bundle").manifest
    assert manifest.training["runs"] == list(load_dataset(folder).runs)
    assert manifest.test["scores"][NETWORK]["share"] < 0.1

    again = run("evaluate", tmp_path / "bundle", folder, "--runs", "r0,r1", "--json")
    assert again.returncode == 0, again.stderr
    result = json.loads(again.stdout)
    assert result["trained_on"] == ["r0", "r1"]
    assert result["scores"][NETWORK]["share"] < 0.1
    told = run("evaluate", tmp_path / "bundle", folder, "--runs", "r0")
    assert "note: the bundle was trained on r0, so these figures flatter it" in told.stderr


def test_the_cubic_fields_lose_nothing_that_was_linear(trained: Result) -> None:
    """EXX runs linearly along X, so the prediction between the measured positions must, too."""
    result = trained
    predictor = Predictor(result.bundle)
    assert predictor.fields.degree == Settings().degree
    coefficients = predictor.follow(result.dataset.runs["r5"].telemetry)[-1]
    q = np.zeros((9, 3))
    q[:, 0] = np.linspace(0.0, 800.0, 9)
    exx = predictor.fields.evaluate(np.tile(coefficients, (9, 1)), q)[:, result.bundle.machine.term_index["EXX"]]
    np.testing.assert_allclose(exx, np.linspace(exx[0], exx[-1], 9), atol=0.02 * np.abs(exx).max())


def test_a_dry_run_says_what_it_would_do_and_does_nothing(folder: Path, tmp_path: Path, run: Run) -> None:
    done = run("train", folder, "--out", tmp_path / "bundle", "--test-runs", "r4,r5", "--dry-run")
    assert done.returncode == 0, done.stderr
    assert "6 runs of 35.8 h" in done.stdout
    assert "it stays out of the bundle's network" in done.stdout
    assert done.stderr == "note: sensor 'ambient' reads 20 °C throughout; is it stuck?\n"
    told = json.loads(run("train", folder, "--out", tmp_path / "bundle", "--dry-run", "--json").stdout)
    dataset = load_dataset(folder)
    assert told["runs"] == list(dataset.runs)
    assert told["terms_measured"] == list(dataset.measured_terms)
    assert told["test_runs"] == default_split(dataset, 0).test_runs
    assert told["trained_again_on_everything"]
    assert list(tmp_path.iterdir()) == []


def test_the_baselines_in_the_table_are_those_trained_on_the_same_runs(trained: Result) -> None:
    dataset, split = trained.dataset, split_by_run(trained.dataset, ["r4", "r5"])
    fitted = fit_baselines(dataset, split, trained.metric, Settings().degree, FAST)
    assert set(trained.scores) == {NO_COMPENSATION, NETWORK, *fitted}
    for name, baseline in fitted.items():
        run = dataset.runs["r4"]
        np.testing.assert_array_equal(trained.methods[name](run), baseline.predict(run))


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--test-runs", "r9"], "thermotrue: --test-runs names run 'r9'"),
        (["--test-runs", "r0,r1,r2,r3,r4,r5"], "thermotrue: test runs must leave runs to train on, got all 6"),
    ],
)
def test_wrong_splits_write_nothing(folder: Path, tmp_path: Path, args: list[str], message: str, run: Run) -> None:
    done = run("train", folder, "--out", tmp_path / "bundle", *args)
    assert done.returncode == 2
    assert done.stderr.startswith(message)
    assert not (tmp_path / "bundle").exists()


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--out", "taken"], "thermotrue: 'taken' exists and is not a bundle; name another folder"),
        (["--out", "file/x"], "thermotrue: bundle 'file/x' cannot be written: '.*file' is a file; name a folder"),
        (["--out", "b", "--picture", "none/day.png"], "thermotrue: picture '.*' must be in a folder that exists"),
        (["--out", "b", "--picture", "day.doc"], "thermotrue: picture 'day.doc' must end in .png, .svg, .pdf, got"),
        (["--out", "b", "--picture", "day.png"], "thermotrue: picture 'day.png' must be a file, got a folder"),
    ],
)
def test_what_cannot_be_written_is_found_before_training(
    folder: Path, tmp_path: Path, args: list[str], message: str, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("precious")
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "work.txt").write_text("precious")
    (tmp_path / "day.png").mkdir()
    monkeypatch.chdir(tmp_path)
    done = run("train", folder, *args)
    assert done.returncode == 2
    assert re.match(message, done.stderr), done.stderr
    assert done.stderr.count("\n") == 1  # no line of progress: nothing was trained


def test_a_bundle_of_another_machine_is_not_evaluated(folder: Path, run: Run) -> None:
    tiny = Path(__file__).parent / "data" / "tiny_bundle"
    done = run("evaluate", tiny, folder)
    assert done.returncode == 2
    assert "must be of a machine with the bundle's error terms" in done.stderr


@pytest.mark.skipif(not ETVE.is_dir(), reason=f"no measured data at {ETVE}; set THERMOTRUE_ETVE to its folder")
def test_a_real_machines_recording_trains_and_its_bundle_predicts(tmp_path: Path) -> None:
    result = train_bundle(ETVE, tmp_path / "bundle", None, 0)
    assert result.left_out.startswith("the last spindle phase, 5000 rpm")
    assert result.scores[NETWORK].share < result.scores[RIDGE].share < 1.0
    predictor = Predictor(load_bundle(tmp_path / "bundle"))
    assert predictor.channels == ("spindle_rpm",)
    assert predictor.datum == "run-start"
    served = MachineState(result.bundle, ServiceSettings(replay=True), time.time, time.monotonic)
    run = result.dataset.runs["etve"].telemetry
    middle = np.array([[400.0, 250.0, 250.0]])
    begin_s = time.time()
    for i in range(0, 1500, 4):
        temperatures = dict(zip(predictor.sensors, map(float, run.temperatures[i]), strict=True))
        channels = {"spindle_rpm": float(run.channels[i, 0])}
        sample = Sample(time=begin_s + float(run.time_s[i]), temperatures=temperatures, channels=channels)
        assert served.take([sample]).accepted == 1
    warm = served.compensate(middle, None, begin_s + float(run.time_s[1499]))
    coefficients = predictor.follow(run)
    expected = predictor.fields.tabulate(coefficients[1496] - coefficients[0]).evaluate(middle)
    tip = served.chain.deviation(middle, expected).position_mm
    np.testing.assert_allclose(warm.deviation_mm, tip, atol=1e-4)
    assert np.abs(warm.correction_mm).max() > 5e-3
