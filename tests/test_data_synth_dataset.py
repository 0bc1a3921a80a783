import numpy as np
import pytest
from click.testing import CliRunner

from data_synth.cli import synth
from data_synth.dataset import make_dataset
from data_synth.machines import DESIGNS, open_shop
from model.error_tables import read_error_table
from model.exceptions import InputError, MachineError
from model.machine import load_machine, preset
from model.tables import read_table
from model.telemetry import read_telemetry

SHOP = open_shop("vmc3")
FILES = {"machine.toml", "dataset.toml", "geometry.csv", "README.md", "overview.png"}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    out = tmp_path_factory.mktemp("synth") / "data"
    make_dataset(SHOP, 3, 1.0, 7, out)
    return out


def changed(tmp_path, old, new):
    """Write the preset with one text replaced."""
    text = preset("vmc3").read_text()
    assert old in text
    (tmp_path / "machine.toml").write_text(text.replace(old, new))
    return str(tmp_path / "machine.toml")


def test_the_folder_is_a_data_set(dataset):
    assert {p.name for p in dataset.iterdir()} == FILES | {"telemetry.parquet", "error_terms.parquet"}
    machine = load_machine(dataset)
    assert machine == SHOP.machine
    assert 'datum = "absolute"' in (dataset / "dataset.toml").read_text()
    runs, channels = read_telemetry(dataset / "telemetry.parquet", tuple(machine.sensors))
    assert list(runs) == ["r00_shop", "r01_steps", "r02_spectrum"]
    assert channels == ["spindle_rpm", "feed_x", "feed_y", "feed_z", "coolant_on"]
    for run in runs.values():
        np.testing.assert_array_equal(run.time_s, np.arange(61) * 60.0)
        assert np.isfinite(run.temperatures).all()


def test_error_terms_are_all_there_at_every_time(dataset):
    table = read_table(dataset / "error_terms.parquet", text=("run", "term"))
    machine = load_machine(dataset)
    assert len(table) == 3 * 13 * (18 * 9 + 24)
    assert np.isfinite(table.numbers["value"]).all()
    for term in machine.terms:
        mine = table.numbers["position"][table.text["term"] == term.name]
        if term.kind == "location":
            assert np.isnan(mine).all()
        else:
            axis = machine.axes[term.axis]
            np.testing.assert_allclose(np.unique(mine), np.linspace(axis.low, axis.high, 9))


def test_cold_errors_are_apart(dataset):
    rows = read_error_table(dataset / "geometry.csv")
    assert {term for term, _, _ in rows} == {term.name for term in SHOP.machine.terms}


def test_the_card_names_seed_command_and_every_constant(dataset):
    text = (dataset / "README.md").read_text()
    assert "thermotrue synth --machine vmc3 --runs 3 --hours 1 --seed 7" in text
    for name in (*SHOP.design.network.nodes, *SHOP.machine.sensors, "r02_spectrum"):
        assert name in text
    assert (dataset / "overview.png").read_bytes().startswith(b"\x89PNG")


def test_the_same_seed_gives_the_same_bytes(dataset, tmp_path):
    make_dataset(SHOP, 3, 1.0, 7, tmp_path / "again")
    for path in dataset.iterdir():
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes(), path.name


def test_csv_holds_what_parquet_holds(dataset, tmp_path):
    make_dataset(SHOP, 3, 1.0, 7, tmp_path / "csv", form="csv")
    assert {p.name for p in (tmp_path / "csv").iterdir()} == FILES | {"telemetry.csv", "error_terms.csv"}
    for name, text in (("telemetry", ("run",)), ("error_terms", ("run", "term"))):
        one, other = (read_table(f, text=text) for f in (dataset / f"{name}.parquet", tmp_path / "csv" / f"{name}.csv"))
        for column, values in one.numbers.items():
            np.testing.assert_array_equal(values, other.numbers[column])
        for column in text:
            np.testing.assert_array_equal(one.text[column], other.text[column])


def test_a_folder_in_use_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match=r"^folder '.*' must be empty"):
        make_dataset(SHOP, 1, 1.0, 0, tmp_path)
    with pytest.raises(InputError, match=r"^folder '.*' must hold a data set to be replaced"):
        make_dataset(SHOP, 1, 1.0, 0, tmp_path, replace=True)
    with pytest.raises(InputError, match=r"^'.*' must be a folder, got a file"):
        make_dataset(SHOP, 1, 1.0, 0, tmp_path / "mine.txt")
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_a_problem_on_the_way_leaves_nothing_and_keeps_what_was(tmp_path):
    out = tmp_path / "data"
    out.mkdir()
    (out / "dataset.toml").write_text("old")

    def fails(items):
        yield items[0]
        raise RuntimeError("power cut")

    with pytest.raises(RuntimeError, match="power cut"):
        make_dataset(SHOP, 2, 0.5, 0, out, replace=True, track=fails)
    assert [p.name for p in tmp_path.iterdir()] == ["data"]
    assert (out / "dataset.toml").read_text() == "old"


def test_a_parent_that_is_a_file_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"^folder '.*' cannot be made"):
        make_dataset(SHOP, 1, 1.0, 0, tmp_path / "file" / "data")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((0, 1.0, 0), "runs must be at least 1, got 0"),
        ((1, 0.1, 0), "hours must be at least 0.167"),
        ((1, float("nan"), 0), "hours must be at least 0.167"),
        ((1, float("inf"), 0), "hours must be at most"),
        ((1, 1.0, -1), "seed must be from 0"),
        ((1, 1.0, 2**32), "seed must be from 0"),
    ],
)
def test_numbers_that_make_no_data_set_are_refused(given, message, tmp_path):
    with pytest.raises(InputError, match=f"^{message}"):
        make_dataset(SHOP, *given, tmp_path / "data")
    assert not list(tmp_path.iterdir())


def test_a_machine_without_a_design_is_named(tmp_path):
    with pytest.raises(InputError, match=r"^machine 'hmc9' must have a thermal design .* the shop has vmc3"):
        open_shop("hmc9")
    with pytest.raises(InputError, match=r"^machine 'mine' must have a thermal design"):
        open_shop(changed(tmp_path, 'name = "vmc3"', 'name = "mine"'))
    assert list(DESIGNS) == ["vmc3"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("range = [0.0, 800.0]", "range = [0.0, 1800.0]", "machine 'vmc3' must have the axes of its preset"),
        ("w X Y b Z t", "w Y X b Z t", "machine 'vmc3' must have the bodies of its preset"),
        ('"motion-last"', '"seed"', "machine 'vmc3' must have the composition of its preset"),
        ("[sensors.motor]", "[sensors.gearbox]", "sensor 'gearbox' of machine 'vmc3' must be one"),
    ],
)
def test_a_description_that_the_design_does_not_fit_is_refused(old, new, message, tmp_path):
    with pytest.raises(MachineError, match=f"^{message}"):
        open_shop(changed(tmp_path, old, new))


def test_a_description_without_sensors_is_refused(tmp_path):
    text = preset("vmc3").read_text()
    (tmp_path / "machine.toml").write_text(text[: text.index("[sensors.")])
    with pytest.raises(MachineError, match=r"^machine 'vmc3' must describe its sensors"):
        open_shop(str(tmp_path))


def test_a_description_may_have_fewer_sensors(tmp_path):
    block = "[sensors.motor]\nrange_degC = [0.0, 120.0]\nmax_rate_degC_per_min = 20.0\n"
    shop = open_shop(changed(tmp_path, block, ""))
    assert len(shop.machine.sensors) == 11


def test_the_command_makes_a_data_set_and_prints_one_line(tmp_path):
    out = tmp_path / "data"
    arguments = ["--machine", "vmc3", "--runs", "1", "--hours", "0.5", "--seed", "2", "--out", str(out)]
    got = CliRunner().invoke(synth, arguments, catch_exceptions=False)
    assert got.exit_code == 0
    assert got.stdout.startswith(f"{out}: 1 runs of 0.5 h of vmc3, seed 2; the tool tip drifts by")
    assert got.stdout.count("\n") == 1
    with pytest.raises(InputError, match=r"^folder '.*' must be empty"):
        CliRunner().invoke(synth, arguments, catch_exceptions=False)
    assert CliRunner().invoke(synth, [*arguments, "--force"]).exit_code == 0
