import json
import re
import tomllib
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from data_synth import climates, cycles
from data_synth.cli import synth
from data_synth.dataset import make_dataset as make
from data_synth.dataset import write_dataset
from data_synth.faults import KINDS, parse
from data_synth.machines import DESIGNS, open_shop
from data_synth.recipe import Recipe
from model.error_tables import read_error_table
from model.exceptions import InputError, MachineError
from model.machine import load_machine, preset
from model.tables import read_table
from model.telemetry import read_telemetry

SHOP = open_shop("vmc3")
PICTURES = {"overview.png", "motion_z.png", "location.png", "angles.png", "volume.png"}
FILES = {"machine.toml", "dataset.toml", "geometry.csv", "README.md", *PICTURES}


make_dataset = partial(make, pictures=False)  # which take most of the time


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    out = tmp_path_factory.mktemp("synth") / "data"
    make(SHOP, 3, 1.0, 7, out)
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
    for picture in PICTURES:
        assert f"]({picture})" in text


def test_the_same_seed_gives_the_same_bytes(dataset, tmp_path):
    make(SHOP, 3, 1.0, 7, tmp_path / "again")
    for path in dataset.iterdir():
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes(), path.name


def test_csv_holds_what_parquet_holds(dataset, tmp_path):
    make(SHOP, 3, 1.0, 7, tmp_path / "csv", form="csv")
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
    with pytest.raises(InputError, match=r"^machine 'hmc9' must have a thermal design .* the shop has vmc3, "):
        open_shop("hmc9")
    with pytest.raises(InputError, match=r"^machine 'mine' must have a thermal design"):
        open_shop(changed(tmp_path, 'name = "vmc3"', 'name = "mine"'))


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


def test_pictures_may_be_left_out(tmp_path):
    make_dataset(SHOP, 1, 0.5, 0, tmp_path / "data")
    assert not list((tmp_path / "data").glob("*.png"))
    text = (tmp_path / "data" / "README.md").read_text()
    assert ".png" not in text
    assert "--no-pictures" in text


def test_runs_take_the_named_cycles_in_turn(tmp_path):
    summaries = make_dataset(SHOP, 3, 0.5, 0, tmp_path / "data", order=("axes", "night"))
    assert [run.name for run in summaries] == ["r00_axes", "r01_night", "r02_axes"]
    text = (tmp_path / "data" / "README.md").read_text()
    assert "--cycles axes,night" in text
    for cycle in ("axes", "night"):
        assert cycles.describe(cycle) in text


@pytest.mark.parametrize(("period_s", "terms_period_s"), [(10.0, 300.0), (60.0, 300.0), (120.0, 360.0), (600.0, 600.0)])
def test_telemetry_comes_at_the_period_asked_for_and_error_terms_after_five_minutes(period_s, terms_period_s, tmp_path):
    make_dataset(SHOP, 1, 2.0, 3, tmp_path / "data", period_s=period_s)
    runs, _ = read_telemetry(tmp_path / "data" / "telemetry.parquet", tuple(SHOP.machine.sensors))
    np.testing.assert_array_equal(runs["r00_shop"].time_s, np.arange(0.0, 7201.0, period_s))
    table = read_table(tmp_path / "data" / "error_terms.parquet", text=("run", "term"))
    np.testing.assert_array_equal(np.unique(table.numbers["time_s"]), np.arange(0.0, 7201.0, terms_period_s))


@pytest.mark.parametrize("period_s", [10.0, 60.0, 1200.0])
def test_the_recipe_knows_how_many_rows_there_will_be(period_s, tmp_path):
    recipe = Recipe(2, 1.2, 0, ("shop",), period_s, faults=parse("all"), tool_tip=True)
    write_dataset(SHOP, recipe, tmp_path / "data", pictures=False)
    for name, rows in recipe.rows(SHOP).items():
        assert len(read_table(tmp_path / "data" / f"{name}.parquet", text=("run", "term"))) == rows


def test_another_climate_is_another_hall(tmp_path):
    cold, warm = (make_dataset(SHOP, 2, 0.5, 0, tmp_path / hall, climate=hall) for hall in ("winter", "summer"))
    ambient = list(SHOP.machine.sensors).index("ambient")
    assert all(a.high_degC[ambient] < b.high_degC[ambient] for a, b in zip(cold, warm, strict=True))
    assert "--climate winter" in (tmp_path / "winter" / "README.md").read_text()


def test_faults_are_a_table_and_their_cells_may_be_empty(tmp_path):
    summaries = make_dataset(SHOP, 2, 4.0, 0, tmp_path / "data", faults=parse("dropout=100,spike=100"))
    faults = read_table(tmp_path / "data" / "faults.parquet", text=("run", "sensor", "kind", "other"))
    assert len(faults) == sum(sum(run.faults.values()) for run in summaries) > 10
    assert set(faults.text["kind"]) == {"dropout", "spike"}
    runs, _ = read_telemetry(tmp_path / "data" / "telemetry.parquet", tuple(SHOP.machine.sensors))
    assert any(np.isnan(run.temperatures).any() for run in runs.values())
    assert "--faults dropout=100,spike=100" in (tmp_path / "data" / "README.md").read_text()


def test_machines_of_one_seed_differ_in_their_cold_errors():
    """A sibling was built by other hands."""
    recipe = Recipe(1, 1.0, 0, ("shop",))
    one, other = (recipe.cold(open_shop(name)) for name in ("vmc3", "vmc3~1"))
    assert [(row.term, row.position) for row in one] == [(row.term, row.position) for row in other]
    a, b = np.array([row.value for row in one]), np.array([row.value for row in other])
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.5


def test_the_card_of_a_sibling_says_so(tmp_path):
    make_dataset(open_shop("vmc3~2"), 1, 0.5, 0, tmp_path / "data")
    text = (tmp_path / "data" / "README.md").read_text()
    assert "--machine vmc3-2 " in text
    assert "Sibling 2 of vmc3" in text


def test_the_command_of_a_description_of_ones_own_names_the_file_beside_the_card(tmp_path):
    block = "[sensors.motor]\nrange_degC = [0.0, 120.0]\nmax_rate_degC_per_min = 20.0\n"
    make_dataset(open_shop(changed(tmp_path, block, "")), 1, 0.5, 0, tmp_path / "data")
    make_dataset(open_shop(str(tmp_path / "data" / "machine.toml")), 1, 0.5, 0, tmp_path / "again")
    assert "synth --machine machine.toml --runs 1" in (tmp_path / "data" / "README.md").read_text()
    for path in (tmp_path / "data").iterdir():
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes(), path.name


def test_the_command_makes_a_data_set_and_prints_one_line(tmp_path):
    out = tmp_path / "data"
    arguments = [
        "--machine",
        "vmc3",
        "--runs",
        "1",
        "--hours",
        "0.5",
        "--seed",
        "2",
        "--out",
        str(out),
        "--no-pictures",
    ]
    got = CliRunner().invoke(synth, arguments, catch_exceptions=False)
    assert got.exit_code == 0
    assert got.stdout.startswith(f"{out}: 1 runs of 0.5 h of vmc3, seed 2; the tool tip drifts by")
    assert got.stdout.count("\n") == 1
    with pytest.raises(InputError, match=r"^folder '.*' must be empty"):
        CliRunner().invoke(synth, arguments, catch_exceptions=False)
    assert CliRunner().invoke(synth, [*arguments, "--force"]).exit_code == 0


def command(*arguments):
    return CliRunner().invoke(synth, ["--machine", "vmc3", "--no-pictures", *arguments], catch_exceptions=False)


def test_a_dry_run_makes_nothing_and_is_near_the_truth(tmp_path):
    arguments = ("--runs", "4", "--hours", "3", "--out", str(tmp_path / "data"), "--json")
    planned = json.loads(command(*arguments, "--dry-run").stdout)
    assert not list(tmp_path.iterdir())
    made = json.loads(command(*arguments).stdout)
    assert planned["rows"] == made["rows"]
    assert [run["name"] for run in planned["runs"]] == [run["name"] for run in made["runs"]]
    tables = sum(path.stat().st_size for path in (tmp_path / "data").glob("*.parquet"))
    assert 0.5 < planned["size_bytes"] / tables < 2.0
    assert planned["seconds"] > 0.0
    assert (planned["made"], made["made"]) == (False, True)


def test_a_dry_run_in_words_counts_runs_and_rows(tmp_path):
    got = command("--runs", "3", "--hours", "1", "--cycles", "shop,axes", "--out", str(tmp_path / "data"), "--dry-run")
    assert "runs: 2 shop, 1 axes" in got.stdout
    assert "rows: 183 of telemetry" in got.stdout
    assert not list(tmp_path.iterdir())


def test_a_dry_run_says_what_the_run_itself_would(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match=r"^folder '.*' must be empty"):
        command("--out", str(tmp_path), "--dry-run")


def test_json_says_what_was_made(tmp_path):
    out = tmp_path / "data"
    got = command("--runs", "2", "--hours", "1", "--seed", "5", "--out", str(out), "--faults", "all", "--json")
    facts = json.loads(got.stdout)
    assert (facts["dataset"], facts["machine"], facts["seed"]) == (str(out), "vmc3", 5)
    assert facts["size_bytes"] == sum(path.stat().st_size for path in out.iterdir())
    assert facts["rows"]["faults"] == sum(sum(run["faults"].values()) for run in facts["runs"])
    assert facts["furthest_um"] == max(run["furthest_um"] for run in facts["runs"]) > 0.0


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--cycles", "shop,shp", "unknown duty cycle 'shp'; did you mean 'shop'"),
        ("--cycles", "rotary", "duty cycle 'rotary' must have a rotary axis"),
        ("--climate", "winer", "unknown climate 'winer'; did you mean 'winter'"),
        ("--faults", "stuk", "faults must be kinds"),
        ("--period", "7", "period must be 1 to 60 s"),
        *(("--period", wrong, "period must be 1 to 60 s") for wrong in ("0", "-60", "nan", "inf")),
        ("--period", "10", "hours must be at most 166.667 at a period of 10 s"),
    ],
)
def test_an_option_that_cannot_be_is_named(option, value, message, tmp_path):
    with pytest.raises(InputError, match=f"^{message}"):
        command("--hours", "500", option, value, "--out", str(tmp_path / "data"))
    assert not list(tmp_path.iterdir())


def test_help_lists_what_the_shop_knows():
    text = " ".join(CliRunner().invoke(synth, ["--help"]).stdout.split())
    for name in (*cycles.NAMES, *climates.CLIMATES, *DESIGNS, *KINDS):
        assert name in text
    assert " ".join(cycles.describe("etve").split()) in text


def test_the_page_on_the_shop_names_its_machines_and_gives_options_that_exist():
    page = (Path(__file__).parents[1] / "docs" / "synthetic-shop.md").read_text()
    for name in DESIGNS:
        assert f"| `{name}` | `{tomllib.loads(preset(name).read_text())['structure']}` |" in page
    known = {option for parameter in synth.params for option in (*parameter.opts, "--help")}
    assert set(re.findall(r"--[a-z][a-z-]*", page)) <= known
