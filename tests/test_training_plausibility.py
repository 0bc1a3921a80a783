"""Units that disagree are found before training, in a sentence that names them; real and synthetic machines pass."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from machines import machine_text
from shop import touch, write_dataset

from data_synth.dataset import make_dataset
from data_synth.machines import open_shop
from model.exceptions import DataError
from model.tables import Table, read_table, write_table
from training.dataset import load_dataset
from training.plan import plan_training
from training.plausibility import RATIO, check_plausible, notices
from training.tip import tip_metric

SENSORS = ("spindle", "ambient")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return four runs of a machine that swings and rolls."""
    path = touch(write_dataset(tmp_path / "d", 4, 3.0), 2, every=4)
    rows = (path / "error_terms.csv").read_text().splitlines()
    turns = [row.replace("EZ0T", "EA0T") for row in rows[1:] if "EZ0T" in row]
    (path / "error_terms.csv").write_text("\n".join([*rows, *turns]) + "\n")
    return path


def changed(folder: Path, file: str, change: Callable[[Table], None]) -> Path:
    """Rewrite a table; cells that were empty stay so."""
    path = folder / f"{file}.csv"
    table = read_table(path, text=("run", "term"))
    change(table)
    cells = {name: ["" if np.isnan(v) else v for v in column] for name, column in table.numbers.items()}
    write_table(path, {**{name: c.tolist() for name, c in table.text.items()}, **cells})
    return folder


def checked(folder: Path) -> list[str]:
    dataset = load_dataset(folder)
    check_plausible(dataset, tip_metric(dataset))
    return notices(dataset)


def of_run(table: Table, run: str) -> np.ndarray:
    return np.asarray(table.text["run"] == run)


def scaled(column: str, factor: float, offset: float = 0.0, run: str | None = None) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        rows = slice(None) if run is None else of_run(table, run)
        table.numbers[column][rows] = factor * table.numbers[column][rows] + offset

    return change


def all_scaled(
    columns: tuple[str, ...], factor: float, offset: float = 0.0, run: str | None = None
) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        for column in columns:
            scaled(column, factor, offset, run)(table)

    return change


def of_term(prefix: str, factor: float) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        rows = np.char.startswith(table.text["term"], prefix)
        table.numbers["value"][rows] *= factor

    return change


def constant(columns: tuple[str, ...]) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        for column in columns:
            table.numbers[column][:] = 21.5

    return change


TIP = ("dx_um", "dy_um", "dz_um")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            [("telemetry", all_scaled(SENSORS, 1.0, 273.15))],
            r"data set '.*': sensor 'spindle' must read .* \(machine.toml\), got 29\d.* it may be in kelvin: subtract",
        ),
        (
            [("telemetry", scaled("spindle", 1.0, 273.15, "r2"))],
            r"data set '.*': sensor 'spindle' must read .*of run 'r2'; it may be in kelvin",
        ),
        (
            [("telemetry", all_scaled(SENSORS, 1.8, 32.0))],
            r"data set '.*': temperatures must be in °C, got none below 6\d.* if they are in °F, convert them",
        ),
        (
            [("telemetry", constant(SENSORS))],
            r"data set '.*': temperatures must change, got constant readings of all 2 sensors; look at the logger",
        ),
        (
            [(file, scaled("time_s", 1000.0)) for file in ("telemetry", "error_terms", "tool_tip")],
            r"data set '.*': time_s must be in seconds, got telemetry of run 'r0' with 33 h between .*milliseconds",
        ),
        (
            [(file, scaled("time_s", 1 / 3600.0)) for file in ("telemetry", "error_terms", "tool_tip")],
            r"data set '.*': time_s must be in seconds and runs last minutes to days, got 2.97 s .* by 3600",
        ),
        (
            [(file, scaled("time_s", 1e-3)) for file in ("error_terms", "tool_tip")],
            r"data set '.*': measurements of run 'r0' must span its telemetry, got 30 within 10.4 s of 1.07e\+04 s",
        ),
        (
            [("error_terms", scaled("value", 1e-3)), ("tool_tip", all_scaled(TIP, 1e-3))],
            r"data set '.*': error_terms and tool_tip must be in µm and µrad, got a tool tip that .* mm and rad",
        ),
        (
            [("error_terms", scaled("value", 1e3)), ("tool_tip", all_scaled(TIP, 1e3))],
            r"data set '.*': error_terms and tool_tip must be in µm and µrad, got .* per kelvin .* convert nm,",
        ),
        (
            [("error_terms", scaled("value", 1e-3, run="r1")), ("tool_tip", all_scaled(TIP, 1e-3, run="r1"))],
            r"data set '.*': all runs must be in the same units, got .* in run 'r1' and by",
        ),
        (
            [("error_terms", of_term("EA", 1e-6))],
            r"data set '.*': error_terms must be in µm and µrad, got .* µrad as the largest of EA0T; .* in rad",
        ),
    ],
)
def test_another_unit_is_named(
    folder: Path, tmp_path: Path, changes: list[tuple[str, Callable[[Table], None]]], message: str
) -> None:
    assert checked(folder) == ["sensor 'ambient' reads 20 °C throughout; is it stuck?"]
    for file, change in changes:
        changed(folder, file, change)
    with pytest.raises(DataError, match=message) as caught:
        plan_training(folder, tmp_path / "bundle", None, 0)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "bundle").exists()


def test_terms_and_tip_in_different_units_are_named(tmp_path: Path) -> None:
    """All terms that move the tip are known in the first run, and the tip in the second."""
    folder = write_dataset(tmp_path / "d", 2, 3.0)
    kept = (folder / "error_terms.csv").read_text().splitlines()
    dataset = load_dataset(folder)
    location = [t.name for t in dataset.machine.terms if t.kind == "location" and t.name != "EZ0T"]
    motion = [t for t in dataset.machine.terms if t.kind == "motion" and t.name != "EXX"]
    rows = [f"{r},{t},{name},,0" for r in ("r0", "r1") for t in (0, 360) for name in location]
    for term in motion:
        axis = dataset.machine.axes[term.axis]
        rows += [f"{r},{t},{term.name},{p},0" for r in ("r0", "r1") for t in (0, 360) for p in (axis.low, axis.high)]
    touch(folder, 2)
    (folder / "error_terms.csv").write_text("\n".join([*kept, *rows]) + "\n")
    checked(folder)
    changed(folder, "tool_tip", all_scaled(TIP, 1e-3))
    with pytest.raises(
        DataError, match=r"data set '.*': error_terms and tool_tip must be in µm and µrad, got terms that"
    ):
        checked(folder)


def test_geometry_in_mm_is_named(folder: Path) -> None:
    (folder / "geometry.csv").write_text("term,position,value\nEXX,0,0\nEXX,800,0.012\n")
    with pytest.raises(
        DataError, match=r"data set '.*': geometry must be in µm and µrad, got 0.012 as the largest value"
    ):
        checked(folder)


def test_one_sensor_in_fahrenheit_is_a_notice(folder: Path) -> None:
    (folder / "machine.toml").write_text(machine_text(extra="[sensors.ambient]\n[sensors.bed]\n"))

    def bed(table: Table) -> None:
        table.numbers["bed"] = 1.8 * (table.numbers["spindle"] - 0.5) + 32.0

    assert any(
        n.startswith("sensor 'bed' is") and n.endswith("is it in °F?")
        for n in checked(changed(folder, "telemetry", bed))
    )


@pytest.mark.parametrize("name", ["vmc3", "seed3", "hmc4", "trunnion5", "gantry3"])
def test_synthetic_machines_pass(tmp_path: Path, name: str) -> None:
    """Runs at rest beside runs at work: what the bounds call a unit must be far from what machines do."""
    make_dataset(
        open_shop(name), 4, 6.0, 2, tmp_path / "d", "csv", order=("etve", "shop", "axes", "spindle"),
        period_s=300.0, tool_tip=True, pictures=False,
    )  # fmt: skip
    assert checked(tmp_path / "d") == []


def test_the_bounds_leave_a_factor_of_three_on_either_side() -> None:
    """A run may move ten times less per kelvin than others (at rest), and a wrong unit is a thousand."""
    assert 10.0 * 3.0 < RATIO < 1000.0 / 3.0
