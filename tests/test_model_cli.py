import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from machines import machine_text

from model.chain import Chain
from model.error_map import ErrorMap
from model.error_tables import read_error_table
from model.machine import parse_machine
from model.tables import read_table, write_table

TINY = Path(__file__).parent / "data" / "tiny_bundle"
THERMOTRUE = str(Path(sys.executable).with_name("thermotrue"))
ERRORS = "term,position,value\nEXX,0,0\nEXX,800,40\nEBZ,0,15\nC0Y,,-20\nEZ0T,,-12.5\n"
POSITIONS = "X,Y,Z,note\n100,50,20,1\n799,-249,499,2\n1,0,1,3\n"


def run(*args: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([THERMOTRUE, *map(str, args)], cwd=cwd, capture_output=True, text=True, check=False)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "machine.toml").write_text(machine_text())
    (tmp_path / "errors.csv").write_text(ERRORS)
    (tmp_path / "positions.csv").write_text(POSITIONS)
    return tmp_path


def test_help_lists_the_commands_in_a_users_order(tmp_path: Path) -> None:
    done = run("--help", cwd=tmp_path)
    places = [
        done.stdout.index(f"\n  {name} ")
        for name in ("describe", "compensate", "synth", "train", "evaluate", "predict", "serve")
    ]
    assert done.returncode == 0
    assert places == sorted(places)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_compensated_positions_put_through_deviation_come_back_to_the_ideal_tip(folder: Path, suffix: str) -> None:
    options = ("--errors", "errors.csv", "--tool-length", 120)
    out = f"corrected.{suffix}"
    done = run("compensate", "machine.toml", "--positions", "positions.csv", "--out", out, *options, cwd=folder)
    assert done.returncode == 0
    assert "warning" not in done.stderr
    assert done.stdout == f"3 positions written to {out}\n"
    table = read_table(folder / out).numbers
    q = np.stack([table[a] for a in "XYZ"], axis=1)
    corrected = np.stack([table[f"{a}_corrected"] for a in "XYZ"], axis=1)
    machine = parse_machine(machine_text())
    chain, tool = Chain(machine), np.array([0.0, 0.0, -120.0])
    errors = ErrorMap.from_rows(machine, read_error_table(folder / "errors.csv"))
    tip = chain.tip(corrected, errors.evaluate(corrected), tool)
    np.testing.assert_allclose(tip, chain.tip(q, None, tool), atol=1e-6)
    assert table["note"].tolist() == [1.0, 2.0, 3.0]


def test_deviation_writes_micrometres_and_microradians(folder: Path) -> None:
    for flag, tolerance in ((), 1e-9), (("--small-angle",), 1e-3):
        done = run(
            "deviation", ".", "--errors", "errors.csv", "--positions", "positions.csv", "--out", "out.csv", *flag,
            cwd=folder,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        table = read_table(folder / "out.csv").numbers
        machine = parse_machine(machine_text())
        errors = ErrorMap.from_rows(machine, read_error_table(folder / "errors.csv"))
        q = np.stack([table[a] for a in "XYZ"], axis=1)
        expected = Chain(machine).deviation(q, errors.evaluate(q))
        for i, a in enumerate("xyz"):
            np.testing.assert_allclose(table[f"d{a}_um"], expected.position_mm[:, i] * 1e3, atol=tolerance)
        for i, a in enumerate("abc"):
            np.testing.assert_allclose(table[f"d{a}_urad"], expected.orientation_rad[:, i] * 1e6, atol=tolerance)


def test_a_table_as_instruments_give_it_turns_the_sign_of_workpiece_side_axes(folder: Path) -> None:
    """X carries the workpiece here: the instrument sees the tool 40 µm further at X = 800, and so does the tip."""
    (folder / "errors.csv").write_text("term,position,value\nEXX,0,0\nEXX,800,40\n")
    (folder / "positions.csv").write_text("X,Y,Z\n800,0,0\n")
    for form, expected in (("tool", 40.0), ("body", -40.0)):
        done = run(
            "deviation", ".", "--errors", "errors.csv", "--positions", "positions.csv", "--out", "out.csv",
            "--relative-to", form, cwd=folder,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert read_table(folder / "out.csv").numbers["dx_um"][0] == pytest.approx(expected, abs=1e-6)


def test_kept_axes_stay_and_what_is_left_is_told(folder: Path) -> None:
    done = run(
        "compensate", ".", "--errors", "errors.csv", "--positions", "positions.csv", "--out", "out.csv", "--keep", "Z",
        cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0
    assert "warning: the free axes do not reach every direction; the tip stays up to 12.5 µm away" in done.stderr
    table = read_table(folder / "out.csv").numbers
    np.testing.assert_array_equal(table["Z_corrected"], table["Z"])
    assert (table["tilt_urad"] > 0.0).any()  # EBZ tilts the tool, and no axis can undo it
    done = run(
        "compensate", ".", "--errors", "errors.csv", "--positions", "positions.csv", "--out", "out.csv", "--keep", "Q",
        cwd=folder,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr == "thermotrue: unknown axis 'Q' to keep; known are X, Y, Z\n"


def test_positions_beyond_the_range_after_correction_are_reported(folder: Path) -> None:
    (folder / "errors.csv").write_text("term,position,value\nEXX,0,-5\n")
    (folder / "positions.csv").write_text("X,Y,Z\n5,0,0\n0,0,0\n")
    done = run(
        "compensate", ".", "--errors", "errors.csv", "--positions", "positions.csv", "--out", "out.csv", cwd=folder
    )
    assert done.returncode == 0
    assert "warning: 1 corrected positions leave an axis' range, the first in row 2" in done.stderr


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        (
            "machine.toml",
            machine_text().replace("range_degC", "rnge_degC"),
            "unknown key 'sensors.spindle.rnge_degC'",
        ),
        ("errors.csv", "term,position\n", "'errors.csv' must have a column 'value', got term, position"),
        (
            "errors.csv",
            "term,position,value\nEXX,a,1\n",
            "'errors.csv', row 1: column 'position' must be a number",
        ),
        ("errors.csv", "term,position,value\nEXX,0\n", "'errors.csv', line 2: must have 3 cells, got 2"),
        ("positions.csv", "X,Y\n1,2\n", "'positions.csv' must have a column 'Z', got X, Y"),
        ("positions.csv", "X,Y,Z\n1,2,3\n1,2,501\n", "axis 'Z' must lie within 0 and 500 mm, got 501 in row 2 of"),
        ("positions.csv", "X,Y,Z\n1,nan,3\n", "axis 'Y' must lie within -250 and 250 mm, got nan in row 1 of"),
        ("positions.csv", "X,X,Z\n1,2,3\n", "'positions.csv' must have each column once, got X, X, Z"),
    ],
)
def test_bad_input_gets_one_line_and_exit_code_2(folder: Path, file: str, text: str, message: str) -> None:
    (folder / file).write_text(text)
    done = run(
        "compensate", ".", "--errors", "errors.csv", "--positions", "positions.csv", "--out", "out.csv", cwd=folder
    )
    assert done.returncode == 2
    assert done.stderr.startswith(f"thermotrue: {message}" if "machine" not in file else "thermotrue: unknown key")
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (folder / "out.csv").exists()


def test_wrong_options_get_one_line_and_exit_code_2(folder: Path) -> None:
    done = run("deviation", "machine.toml", "--error", "x", cwd=folder)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("thermotrue: No such option")


def test_a_defect_of_ours_gets_one_line_and_exit_code_1(folder: Path) -> None:
    (folder / "machine.toml").write_text(machine_text("w Y b X Z t"))
    zigzag = "term,position,value\n" + "".join(f"EXX,{p},{0 if p % 2 else 2000}\n" for p in range(400))
    (folder / "errors.csv").write_text(zigzag)
    (folder / "positions.csv").write_text("X,Y,Z\n200.3,0,0\n")
    done = run(
        "compensate", ".", "--errors", "errors.csv", "--positions", "positions.csv", "--out", "out.csv", cwd=folder
    )
    assert done.returncode == 1
    assert done.stderr.startswith("thermotrue: compensation at X 200.3, Y 0, Z 0 must reach 1 nm")


def test_predict_follows_the_lag_from_the_first_sample(tmp_path: Path) -> None:
    hours = np.arange(0.0, 8 * 3600.0, 60.0)
    warm = np.where(hours > 0, 21.0, 20.0)
    write_table(
        tmp_path / "telemetry.csv",
        {
            "run": ["r"] * len(hours),
            "time_s": hours,
            **dict.fromkeys(("spindle", "column", "ambient"), warm),
            "spindle_rpm": np.zeros(len(hours)),
        },
    )
    write_table(
        tmp_path / "positions.csv",
        {"run": ["r"] * 2, "time_s": [0.0, 28740.0], "X": [0.0, 0.0], "Y": [0.0, 0.0], "Z": [0.0, 0.0]},
    )
    done = run("predict", TINY, "telemetry.csv", "--positions", "positions.csv", "--out", "tip.parquet", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    table = read_table(tmp_path / "tip.parquet")
    assert [*table.text, *table.numbers] == ["run", "time_s", "X", "Y", "Z", "dx_um", "dy_um", "dz_um"]
    np.testing.assert_allclose(table.numbers["dz_um"], [0.0, -4.0], atol=1e-3)


@pytest.mark.parametrize(
    ("telemetry", "positions", "message"),
    [
        (
            "run,time_s,spindle,column,spindle_rpm\nr,0,20,20,0\n",
            "",
            "'t.csv' must have a column for each sensor .*",
        ),
        ("run,time_s,spindle,column,ambient\nr,0,20,20,20\n", "", "'t.csv' must have the channel 'spindle_rpm'"),
        (
            "run,time_s,spindle,column,ambient,spindle_rpm\nr,0,20,inf,20,0\n",
            "",
            "'t.csv': temperature 'column' must be a finite number, got inf in row 1",
        ),
        (
            "run,time_s,spindle,column,ambient,spindle_rpm\nr,0,20,,20,0\n",
            "",
            "'t.csv': sensor 'column' must have a reading in run 'r', got none",
        ),
        (
            "run,time_s,spindle,column,ambient,spindle_rpm\nr,0,20,20,20,0\nr,0,20,20,20,0\n",
            "",
            "'t.csv': time_s must rise within run 'r', got 0 after 0 in row 2",
        ),
        (
            "run,time_s,spindle,column,ambient,spindle_rpm\nr,5,20,20,20,0\n",
            "run,time_s,X,Y,Z\nr,1,0,0,0\n",
            "times in run 'r' of 'p.csv' must not lie before its telemetry, which starts at 5 s, got 1",
        ),
        (
            "run,time_s,spindle,column,ambient,spindle_rpm\nr,5,20,20,20,0\n",
            "run,time_s,X,Y,Z\nr,5,0,0,0\nr,6,0,0,0\n",
            "times in run 'r' of 'p.csv' must not lie after its telemetry, which ends at 5 s, got 6 in row 2",
        ),
        (
            "run,time_s,spindle,column,ambient,spindle_rpm\nr,5,20,20,20,0\n",
            "run,time_s,X,Y,Z\nr,inf,0,0,0\n",
            "times in run 'r' of 'p.csv' must not lie after its telemetry, which ends at 5 s, got inf in row 1",
        ),
        (
            "run,time_s,spindle,column,ambient,spindle_rpm\nr,0,20,20,20,0\nr,1,20,3276.7,20,0\n",
            "",
            "'t.csv': temperature 'column' must lie within ±1000 °C, got 3276.7 in row 2",
        ),
        (
            "run,time_s,spindle,column,ambient,spindle_rpm\nr,0,20,20,20,-1e10\n",
            "",
            r"'t.csv': channel 'spindle_rpm' must lie within ±1e\+09, got -1e\+10 in row 1",
        ),
        (
            "run,time_s,spindle,column,ambient,spindle_rpm\nr,5,20,20,20,0\n",
            "run,time_s,X,Y,Z\ns,6,0,0,0\n",
            "run 's' of 'p.csv' must be in 't.csv', got r",
        ),
    ],
)
def test_bad_telemetry_gets_one_sentence(tmp_path: Path, telemetry: str, positions: str, message: str) -> None:
    (tmp_path / "t.csv").write_text(telemetry)
    (tmp_path / "p.csv").write_text(positions or "run,time_s,X,Y,Z\nr,0,0,0,0\n")
    done = run("predict", TINY, "t.csv", "--positions", "p.csv", "--out", "o.csv", cwd=tmp_path)
    assert done.returncode == 2
    import re

    assert re.match(f"thermotrue: {message}", done.stderr), done.stderr
