from pathlib import Path

import numpy as np
import pytest
from shop import write_dataset

from model.exceptions import InputError
from training.dataset import load_dataset, runs_named
from training.plausibility import notices
from training.split import default_split, everything, last_phase, split_by_run


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("set") / "data")


def test_reads_what_was_written(folder: Path) -> None:
    dataset = load_dataset(folder)
    assert (dataset.sensors, dataset.channels) == (("spindle", "ambient"), ("spindle_rpm",))
    assert dataset.columns == (("EXX", 0.0), ("EXX", 400.0), ("EXX", 800.0), ("EZ0T", None))
    assert dataset.terms == ("EXX", "EZ0T")
    assert dataset.datum == "absolute"
    run = dataset.runs["r1"]
    np.testing.assert_allclose(run.values[:, 2], -16.0 / 5.0 * run.values[:, 3])
    assert np.isfinite(run.values).all()


def test_what_is_known_between_samples_is_interpolated(folder: Path) -> None:
    run = load_dataset(folder).runs["r0"]
    np.testing.assert_allclose(run.between(run.telemetry.time_s), run.time_s)
    np.testing.assert_allclose(run.between(run.telemetry.time_s[:, None] * [1.0, 2.0])[:, 1], 2 * run.time_s)


def test_gaps_in_the_measurements_are_kept_as_gaps(folder: Path, tmp_path: Path) -> None:
    copy = write_dataset(tmp_path / "d", 1)
    rows = (copy / "error_terms.csv").read_text().splitlines()
    (copy / "error_terms.csv").write_text("\n".join(rows[:1] + rows[2:]) + "\n")
    values = load_dataset(copy).runs["r0"].values
    assert np.isnan(values[0, 3])
    assert np.isnan(values).sum() == 1


def replaced(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        (
            "telemetry.csv",
            ",ambient,",
            ",outside,",
            "'.*' must have a column for each sensor of the machine, got none",
        ),
        ("telemetry.csv", "r0,0.0,", "r0,0.0,inf,", "'.*telemetry.csv', line 2: must have 5 cells, got 6"),
        ("error_terms.csv", "value", "amount", "'.*error_terms.csv' must have a column 'value', got"),
        ("error_terms.csv", "EZ0T,,", "EZ0T,5,", "'.*error_terms.csv': EZ0T is a location term without position"),
        (
            "error_terms.csv",
            "EXX,400.0",
            "EXX,900.0",
            "'.*': EXX must have positions within axis X, 0 to 800 mm, got 9",
        ),
        (
            "error_terms.csv",
            "EXX,400.0",
            "EXX,",
            "'.*': EXX must have positions within axis X, .*got an empty position",
        ),
        ("error_terms.csv", "EXX,400.0", "EXX,0.0", "'.*': EXX at position 0 and time 0 stands twice in run 'r0'"),
        ("error_terms.csv", "EXX,400.0", "EQX,400.0", "'.*': unknown error term 'EQX' for machine 'test'"),
        ("error_terms.csv", "r0,0.0", "rx,0.0", "'.*error_terms.csv': run 'rx' must be in the telemetry, got r0"),
        (
            "error_terms.csv",
            "r0,0.0",
            "r0,-9.0",
            "'.*': measurements of run 'r0' must lie within its telemetry, 0 to",
        ),
        (
            "error_terms.csv",
            "r0,360.0,EZ0T",
            "r0,0.0,EZ0T",
            r"'.*error_terms.csv': EZ0T at time 0 stands twice in run 'r0', again in row 5; keep one",
        ),
        (
            "error_terms.csv",
            "EZ0T,,-",
            "EZ0T,,-9999999",
            r"'.*error_terms.csv': value must lie within ±1e\+06 µm or µrad, got -1e\+",
        ),
        ("telemetry.csv", "r0,0.0,", "r0,0.0,100", "'.*telemetry.csv': temperature 'spindle' must lie within ±1000 °C"),
        (
            "error_terms.csv",
            "r0,0.0",
            "r0,nan",
            "'.*error_terms.csv': time_s must be a finite number, got nan in row 1",
        ),
        ("dataset.toml", "absolute", "cold", "key 'datum' in '.*': input should be 'absolute' or 'run-start'"),
        ("dataset.toml", "datum", "dattum", "unknown key 'dattum' in '.*dataset.toml'; did you mean 'datum'"),
        ("dataset.toml", '"absolute"', "", "'.*dataset.toml' is not TOML"),
    ],
)
def test_a_wrong_data_set_gets_one_sentence(tmp_path: Path, file: str, old: str, new: str, message: str) -> None:
    folder = write_dataset(tmp_path / "d", 1, 1.0)
    replaced(folder / file, old, new)
    with pytest.raises(InputError, match=message) as caught:
        load_dataset(folder)
    assert "\n" not in str(caught.value)


def test_a_run_of_one_sample_is_named_and_one_without_measurements_is_kept_in_mind(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "d", 2, 1.0)
    telemetry = (folder / "telemetry.csv").read_text().splitlines()
    short = [row for row in telemetry if not row.startswith("r1") or row.startswith("r1,0.0,")]
    (folder / "telemetry.csv").write_text("\n".join(short) + "\n")
    with pytest.raises(
        InputError, match="'.*': run 'r1' must have at least two rows of telemetry, got one; take it out"
    ):
        load_dataset(folder)
    (folder / "telemetry.csv").write_text("\n".join(telemetry) + "\n")
    terms = (folder / "error_terms.csv").read_text().splitlines()
    (folder / "error_terms.csv").write_text("\n".join(row for row in terms if not row.startswith("r1")) + "\n")
    dataset = load_dataset(folder)
    assert (tuple(dataset.runs), dataset.unmeasured) == (("r0",), ("r1",))
    assert "runs without a measurement are left aside: r1" in notices(dataset)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("EQQ,,1", "'.*geometry.csv', row 2: unknown error term 'EQQ' for machine 'test'"),
        ("EXX,0,2e6", r"'.*geometry.csv': value must lie within ±1e\+06 µm or µrad, got 2e\+06 in row 2"),
    ],
)
def test_wrong_geometry_is_found_when_the_data_set_is_read(tmp_path: Path, text: str, message: str) -> None:
    folder = write_dataset(tmp_path / "d", 1, 1.0)
    (folder / "geometry.csv").write_text(f"term,position,value\nEYX,0,1\n{text}\n")
    with pytest.raises(InputError, match=message):
        load_dataset(folder)


def test_a_folder_in_the_place_of_dataset_toml_is_not_the_default(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "d", 1, 1.0)
    (folder / "dataset.toml").unlink()
    (folder / "dataset.toml").mkdir()
    with pytest.raises(InputError, match="'.*dataset.toml' cannot be read: Is a directory"):
        load_dataset(folder)


@pytest.mark.parametrize(
    ("gone", "message"),
    [
        ("telemetry.csv", "data set '.*' must have telemetry.parquet or telemetry.csv, got neither"),
        ("error_terms.csv", "data set '.*' must have error_terms.parquet or error_terms.csv, or tool_tip.*, got none"),
        ("machine.toml", "machine description '.*' cannot be read"),
    ],
)
def test_a_missing_file_is_named(tmp_path: Path, gone: str, message: str) -> None:
    folder = write_dataset(tmp_path / "d", 1, 1.0)
    (folder / gone).unlink()
    with pytest.raises(InputError, match=message):
        load_dataset(folder)


def test_a_machine_without_sensors_and_no_folder(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "d", 1, 1.0)
    text = (folder / "machine.toml").read_text()
    (folder / "machine.toml").write_text(text.split("[sensors")[0])
    with pytest.raises(InputError, match="data set '.*': machine.toml must describe its sensors"):
        load_dataset(folder)
    with pytest.raises(InputError, match="data set '.*' must be a folder"):
        load_dataset(tmp_path / "none")


def test_no_measurement_is_on_both_sides_of_a_split(folder: Path) -> None:
    dataset = load_dataset(folder)
    for split in (default_split(dataset, 0), split_by_run(dataset, ["r1", "r2"]), everything(dataset)):
        for name in dataset.runs:
            assert (split.train[name] ^ split.test[name]).all()
    assert len(default_split(dataset, 0).test_runs) == 1
    assert split_by_run(dataset, ["r1", "r2"]).train_runs == ["r0", "r3"]


def test_a_single_run_is_split_at_its_last_spindle_phase(tmp_path: Path) -> None:
    dataset = load_dataset(write_dataset(tmp_path / "d", 1))
    run = dataset.runs["r0"]
    start_s, what = last_phase(dataset, run)
    speed = run.telemetry.channels[:, 0]
    after = run.telemetry.time_s >= start_s
    assert len(np.unique(speed[after])) == 1
    assert speed[~after][-1] != speed[after][0]
    assert what == f"the last spindle phase, {speed[-1]:g} rpm"
    split = default_split(dataset, 0)
    assert run.time_s[split.train["r0"]].max() < start_s <= run.time_s[split.test["r0"]].min()


def test_splits_that_leave_nothing_are_refused(folder: Path) -> None:
    dataset = load_dataset(folder)
    with pytest.raises(InputError, match="test runs must leave runs to train on, got all 4"):
        split_by_run(dataset, list(dataset.runs))
    with pytest.raises(InputError, match="test runs must name at least one run, got none"):
        split_by_run(dataset, [])
    with pytest.raises(InputError, match="--test-runs names run 'r9'; data set '.*' has r0, r1, r2, r3"):
        runs_named(dataset, ["r9"], "--test-runs")
