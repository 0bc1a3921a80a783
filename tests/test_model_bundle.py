import errno
import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bundles import edit
from machines import machine_text

from model.bundle import load_bundle, machine_of, parse_bundle, read_files, version_of, write_bundle
from model.exceptions import BundleError, ComputeError, DataError
from model.machine import parse_machine
from model.manifest import Manifest
from model.predictor import Predictor
from model.telemetry import Run
from model.validation import check

TINY = Path(__file__).parent / "data" / "tiny_bundle"


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    return Path(shutil.copytree(TINY, tmp_path / "bundle"))


def test_a_bundle_without_network_is_a_geometric_machine(tmp_path: Path) -> None:
    machine = parse_machine(machine_text())
    bundle = write_bundle(tmp_path / "geometric", machine, geometry=[("EXX", 100.0, 5.0)])
    assert bundle.network is None
    assert bundle.geometry.evaluate(np.zeros((1, 3)))[0, machine.term_index["EXX"]] == pytest.approx(0.005)
    with pytest.raises(BundleError, match="bundle .* has no network: it is geometric only"):
        Predictor(bundle)


def test_writing_again_replaces_a_bundle_and_nothing_else(tmp_path: Path) -> None:
    machine = parse_machine(machine_text())
    first = write_bundle(tmp_path / "b", machine)
    second = write_bundle(tmp_path / "b", machine, geometry=[("EC0Y", None, 1.0)])
    assert first.version != second.version
    assert [p.name for p in tmp_path.iterdir()] == ["b"]
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "work.txt").write_text("precious")
    with pytest.raises(BundleError, match="'.*other' exists and is not a bundle; name another folder"):
        write_bundle(tmp_path / "other", machine)
    assert (tmp_path / "other" / "work.txt").read_text() == "precious"


def test_machine_of_a_bundle_a_file_and_a_folder(copy: Path) -> None:
    assert machine_of(copy).name == machine_of(copy / "machine.toml").name == "tiny"


@pytest.mark.parametrize("name", ["machine.toml", "network.onnx", "geometry.csv"])
def test_a_changed_file_is_refused(copy: Path, name: str) -> None:
    with (copy / name).open("ab") as file:
        file.write(b" ")
    with pytest.raises(BundleError, match=rf"bundle '.*': {name} does not match manifest.json \(sha256 differs\)"):
        load_bundle(copy)


@pytest.mark.parametrize("name", ["machine.toml", "network.onnx", "geometry.csv", "manifest.json"])
def test_a_missing_file_is_named(copy: Path, name: str) -> None:
    (copy / name).unlink()
    with pytest.raises(BundleError, match=rf"bundle '.*': {name} is missing; export it again"):
        load_bundle(copy)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.update(format_version=99), "bundle '.*' has format version 99, this release reads 2"),
        (
            lambda m: m.update(machine="other"),
            "bundle '.*': manifest.json is for machine 'other', machine.toml for",
        ),
        (lambda m: m.update(extra=1), "unknown key 'extra' in bundle '.*', manifest.json"),
        (
            lambda m: m["files"].update({"../x": "0"}),
            r"bundle '.*': manifest.json lists '../x'; a bundle has only",
        ),
        (lambda m: m["files"].pop("geometry.csv"), "bundle '.*': manifest.json has no checksum of geometry.csv"),
        (
            lambda m: m.update(network=None),
            "bundle '.*': network.onnx and the manifest's 'network' must come together",
        ),
        (lambda m: m["network"]["sensors"].append("oil"), "bundle '.*': manifest.json: the network needs sensor 'oil'"),
        (
            lambda m: m["network"]["valid_range_degC"].pop("column"),
            "bundle '.*': manifest.json: valid_range_degC must have the range of each .*: 'column'",
        ),
        (
            lambda m: m["network"]["sensor_mean_degC"].pop(),
            "bundle '.*': manifest.json: sensor statistics must be",
        ),
        (
            lambda m: m["network"].update(sensor_covariance_K2=[[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
            "bundle '.*': manifest.json: sensor_covariance_K2 must be symmetric and positive semidefinite",
        ),
        (
            lambda m: m["network"]["terms"].append("EXX"),
            "bundle '.*': manifest.json must name each error term of the network once",
        ),
        (
            lambda m: m["network"]["valid_range_degC"].update(column=[30.0, 20.0]),
            r"bundle '.*': manifest.json: valid_range_degC of 'column' must rise, got \[30, 20\]",
        ),
        (
            lambda m: m["network"].update(time_constants_s=[300.0, 0.0]),
            "bundle '.*': manifest.json: time_constants_s must be positive",
        ),
        (
            lambda m: m["network"].update(modes=7),
            "bundle '.*': manifest.json: modes must be a multiple of the 2 time constants, got 7",
        ),
        (
            lambda m: m["network"].update(settling_time_s=1e12),
            "bundle '.*': manifest.json: settling_time_s must be at most",
        ),
        (
            lambda m: m["network"]["sensor_mean_degC"].__setitem__(0, 1e12),
            "bundle '.*': manifest.json: sensor statistics must be those of temperatures",
        ),
    ],
)
def test_a_wrong_manifest_gets_one_sentence(copy: Path, change: Callable[[dict], object], message: str) -> None:
    edit(copy, change)
    with pytest.raises(BundleError, match=message):
        load_bundle(copy)


def test_no_folder_and_no_json(tmp_path: Path, copy: Path) -> None:
    with pytest.raises(BundleError, match=r"bundle '.*' must be a folder with machine.toml and manifest.json"):
        load_bundle(tmp_path / "nothing")
    (copy / "manifest.json").write_text("{")
    with pytest.raises(BundleError, match="bundle '.*': manifest.json is not JSON"):
        load_bundle(copy)


@pytest.mark.parametrize(
    ("text", "kind"), [("[]", "a list"), ('"x"', "a text"), ("null", "nothing"), ("3", "a number")]
)
def test_a_manifest_that_is_no_object(copy: Path, text: str, kind: str) -> None:
    (copy / "manifest.json").write_text(text)
    with pytest.raises(BundleError, match=f"bundle '.*': manifest.json must be an object, got {kind}; export it again"):
        load_bundle(copy)


def test_a_record_that_is_no_object_is_told_so_without_a_key() -> None:
    with pytest.raises(BundleError, match=r"^here must be an object with keys, got \[\]$"):
        check(Manifest, [], "here", BundleError)  # type: ignore[arg-type]


def test_a_bundle_where_none_can_be_gets_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = parse_machine(machine_text())
    (tmp_path / "file").write_text("precious")
    with pytest.raises(BundleError, match="bundle '.*x' cannot be written: '.*file' is a file; name a folder"):
        write_bundle(tmp_path / "file" / "x", machine)
    with pytest.raises(BundleError, match="bundle '.*' cannot be written: File name too long"):
        write_bundle(tmp_path / ("x" * 300), machine)

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("model.bundle.write_error_table", full)
    with pytest.raises(BundleError, match="bundle '.*b' cannot be written: No space left on device"):
        write_bundle(tmp_path / "b", machine)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('{"machine": "tiny", "machine": "tiny"}', "key 'machine' stands twice"),
        ('{"a": NaN}', "numbers must be finite, got NaN"),
        ('{"a": 1e999}', "numbers must be finite, got 1e999"),
        ('{"a": ' + "9" * 5000 + "}", "whole numbers must have at most 16 digits"),
        ("[" * 100_000, "it is nested too deeply"),
    ],
)
def test_a_manifest_that_could_mean_two_things(copy: Path, text: str, why: str) -> None:
    (copy / "manifest.json").write_text(text)
    with pytest.raises(BundleError, match=f"bundle '.*': manifest.json is not JSON: {why}"):
        load_bundle(copy)


def test_any_edit_of_the_manifest_is_noticed(copy: Path) -> None:
    text = (copy / "manifest.json").read_text()
    (copy / "manifest.json").write_text(text.replace('"settling_time_s": 3600.0', '"settling_time_s": 36000.0'))
    with pytest.raises(BundleError, match=r"bundle '.*': manifest.json is not as it was written \(its digest"):
        load_bundle(copy)


def test_bytes_and_folder_are_one_bundle() -> None:
    files = read_files(TINY)
    one, other = load_bundle(TINY), parse_bundle(files, "upload")
    assert (one.version, one.manifest, one.machine) == (other.version, other.manifest, other.machine)
    assert one.geometry.rows() == other.geometry.rows()
    with pytest.raises(BundleError, match="bundle 'upload' must have only machine.toml, .*, got 'notes.txt'"):
        parse_bundle({**files, "notes.txt": b""}, "upload")
    with pytest.raises(BundleError, match="bundle 'upload': geometry.csv must have at most 8388608 bytes, got more"):
        parse_bundle({**files, "geometry.csv": b"0" * (8 * 1024 * 1024 + 1)}, "upload")


def test_the_version_is_known_without_reading_the_contents() -> None:
    files = read_files(TINY)
    assert version_of(files) == load_bundle(TINY).version
    for name, content in files.items():
        assert version_of({**files, name: content[:-1]}) is None
    assert version_of({}) is None


@pytest.mark.parametrize(
    "change",
    [
        lambda n: n["parity"]["coefficients"]["EZ0T"][7].__setitem__(
            0, n["parity"]["coefficients"]["EZ0T"][7][0] + 1e-5
        ),
        lambda n: n["parity"]["inputs"].update(spindle=n["parity"]["inputs"]["column"]),
        lambda n: n["terms"].__setitem__(slice(1, 3), n["terms"][:0:-1]),  # names exchanged, and nothing else
    ],
)
def test_a_network_that_computes_something_else_is_refused(copy: Path, change: Callable[[dict], object]) -> None:
    edit(copy, lambda m: change(m["network"]))
    with pytest.raises(BundleError, match="bundle '.*': network.onnx must return what it did .* to 1e-06 µm"):
        Predictor(load_bundle(copy))


@pytest.mark.parametrize(
    "change",
    [
        lambda p: p["dt_s"].pop(),
        lambda p: p["inputs"].pop("column"),
        lambda p: p["coefficients"].pop("EXX"),
        lambda p: p["coefficients"]["EXX"][0].pop(),
    ],
)
def test_a_parity_sample_of_another_network_is_refused(copy: Path, change: Callable[[dict], object]) -> None:
    edit(copy, lambda m: change(m["network"]["parity"]))
    with pytest.raises(BundleError, match="bundle '.*': the manifest's parity sample is not one of this network"):
        Predictor(load_bundle(copy))


def test_a_network_that_does_not_fit_its_manifest_is_refused(copy: Path) -> None:
    edit(copy, lambda m: m["network"].update(modes=4))
    with pytest.raises(BundleError, match="bundle '.*': network.onnx must take .* got .*; export it again"):
        Predictor(load_bundle(copy))


PREDICTOR = Predictor(load_bundle(TINY))
IDLE = np.zeros(1)


def test_the_tiny_network_answers_as_worked_out_by_hand() -> None:
    state = PREDICTOR.start(0.0, np.full(3, 21.0), IDLE)
    np.testing.assert_allclose(state.coefficients, [4.0, 4.0, 2.0, -4.0], atol=1e-12)


def test_modes_follow_a_step_as_first_order_lags() -> None:
    """After the time t a lag has come 1 - exp(-t / τ) of the way, here with τ of 300 and 3600 s."""
    state = PREDICTOR.start(0.0, np.full(3, 20.0), IDLE)
    state = PREDICTOR.step(state, 1e-3, np.full(3, 21.0), IDLE)  # a step, but for a millisecond
    for t in (60.0, 300.0, 4000.0):
        state = PREDICTOR.step(state, t, np.full(3, 21.0), IDLE)
        expected = 1.0 - np.exp(-t / np.array([300.0, 3600.0]))
        np.testing.assert_allclose(state.modes.reshape(4, 2)[:3], np.tile(expected, (3, 1)), atol=1e-5)


def test_a_finer_walk_along_a_ramp_arrives_at_the_same_state() -> None:
    """First-order hold is exact for ramps, so samples in between change nothing."""
    ramp = [20.0 + 0.01 * t for t in (0.0, 1000.0)]
    coarse = PREDICTOR.start(0.0, np.full(3, ramp[0]), IDLE)
    coarse = PREDICTOR.step(coarse, 1000.0, np.full(3, ramp[1]), IDLE)
    fine = PREDICTOR.start(0.0, np.full(3, ramp[0]), IDLE)
    for t in np.sort(np.append(np.random.default_rng(7).uniform(0, 1000, 50), 1000.0)):
        fine = PREDICTOR.step(fine, float(t), np.full(3, 20.0 + 0.01 * t), IDLE)
    np.testing.assert_allclose(fine.modes, coarse.modes, atol=1e-10)


def test_a_missing_sensor_is_estimated_and_time_does_not_go_back() -> None:
    state = PREDICTOR.start(10.0, np.array([25.0, np.nan, 20.0]), IDLE)
    assert state.inputs[1] == pytest.approx(22.0, abs=0.1)
    with pytest.raises(ComputeError, match="samples must come in the order of time, got one 5 s before the last"):
        PREDICTOR.step(state, 5.0, np.full(3, 20.0), IDLE)


def test_following_a_run_is_stepping_through_it() -> None:
    rng = np.random.default_rng(8)
    run = Run("r", np.cumsum(rng.uniform(1, 300, 20)), rng.uniform(18, 30, (20, 3)), rng.uniform(0, 9000, (20, 1)))
    followed = PREDICTOR.follow(run)
    state = PREDICTOR.start(float(run.time_s[0]), run.temperatures[0], run.channels[0])
    for i in range(1, 20):
        state = PREDICTOR.step(state, float(run.time_s[i]), run.temperatures[i], run.channels[i])
    np.testing.assert_array_equal(followed[-1], state.coefficients)


def test_geometry_rows_are_checked_on_loading(copy: Path) -> None:
    (copy / "geometry.csv").write_text("term,position,value\nEQQ,,1\n")
    with pytest.raises(BundleError, match="geometry.csv does not match"):
        load_bundle(copy)
    digest = hashlib.sha256((copy / "geometry.csv").read_bytes()).hexdigest()
    edit(copy, lambda m: m["files"].update({"geometry.csv": digest}))
    with pytest.raises(DataError, match="bundle '.*', geometry.csv, row 1: unknown error term 'EQQ'"):
        load_bundle(copy)
