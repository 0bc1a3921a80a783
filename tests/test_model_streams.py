import csv
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from machines import machine_text

from model.exceptions import DataError
from model.machine import parse_machine
from model.positions import coordinates
from model.streams import Chunk, create_table, open_table, transform
from model.tables import read_table, write_table

THERMOTRUE = str(Path(sys.executable).with_name("thermotrue"))
ERRORS = "term,position,value\nEXX,0,0\nEXX,800,40\nEBZ,0,15\nC0Y,,-20\nEZ0T,,-12.5\n"
AWKWARD = 'X,note,Y,n,Z\r\n1.50,"a, ""b""",2,007,3\n\n 4,"two\nlines",5,,6\n7,µ → ü,8e0,-0,+9\n1,"",2,1e400,3'
"""Quotes, a comma, line ends within a cell, a blank line, blanks, leading zeros, a number no double holds, no last line
end."""
MACHINE = parse_machine(machine_text())


def doubled(chunk: Chunk) -> Mapping[str, np.ndarray]:
    return {"X2": 2.0 * chunk.numbers("X"), "half": chunk.numbers("Z") / 2.0}


def stream(source: Path, out: Path, chunk_rows: int = 4096, required: Sequence[str] = ("X", "Z")) -> int:
    return transform(source, out, required, doubled, "doubling", chunk_rows=chunk_rows)


def many(folder: Path, rows: int, suffix: str = "csv") -> Path:
    rng = np.random.default_rng(3)
    path = folder / f"many.{suffix}"
    write_table(path, dict(zip("XYZ", np.round(rng.uniform(0, 250, (3, rows)), 3), strict=True)))
    return path


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_chunk_boundaries_do_not_show(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "in.csv").write_text(AWKWARD, encoding="utf-8", newline="")
    outputs = []
    for rows in (1, 2, 7, 4096):
        out = tmp_path / f"out{rows}.{suffix}"
        assert stream(tmp_path / "in.csv", out, rows) == 4
        outputs.append(out.read_bytes())
    assert len(set(outputs)) == 1


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_parquet_chunk_boundaries_do_not_show(tmp_path: Path, suffix: str) -> None:
    source = many(tmp_path, 50, "parquet")
    outputs = []
    for rows in (1, 7, 4096):
        out = tmp_path / f"out{rows}.{suffix}"
        assert stream(source, out, rows) == 50
        outputs.append(out.read_bytes())
    assert len(set(outputs)) == 1


def test_csv_columns_nobody_computes_with_leave_as_they_entered(tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text(AWKWARD, encoding="utf-8", newline="")
    stream(tmp_path / "in.csv", tmp_path / "out.csv", 2)
    text = (tmp_path / "out.csv").read_text(encoding="utf-8")
    assert text == (
        'X,note,Y,n,Z,X2,half\n1.50,"a, ""b""",2,007,3,3.0,1.5\n 4,"two\nlines",5,,6,8.0,3.0\n'
        '7,µ → ü,8e0,-0,+9,14.0,4.5\n1,"",2,1e400,3,2.0,1.5\n'
    )


def test_parquet_columns_nobody_computes_with_keep_type_value_and_metadata(tmp_path: Path) -> None:
    carried = {
        "n": pyarrow.array([1, None, 2**62], pyarrow.int64()),
        "small": pyarrow.array([0.1, float("nan"), None], pyarrow.float32()),
        "at": pyarrow.array([datetime(2026, 1, 2, 3, 4, 5, 6, UTC), None, None], pyarrow.timestamp("us", "UTC")),
        "kind": pyarrow.array(["a", "b", "a"]).dictionary_encode(),
        "list": pyarrow.array([[1], [], None], pyarrow.list_(pyarrow.int8())),
        "text": pyarrow.array(['a, "b"', "", None]),
    }
    axes = {"X": pyarrow.array([1, 2, 3]), "Z": pyarrow.array(["1", " 2", "3e0"])}
    table = pyarrow.table({**carried, **axes}).replace_schema_metadata({"made": "here"})
    pyarrow.parquet.write_table(table, tmp_path / "in.parquet")
    stream(tmp_path / "in.parquet", tmp_path / "out.parquet", 2)
    out = pyarrow.parquet.read_table(tmp_path / "out.parquet")
    assert out.column_names == [*table.column_names, "X2", "half"]
    assert out.schema.metadata[b"made"] == b"here"
    for name in table.column_names:
        assert out.schema.field(name) == table.schema.field(name)
        assert repr(out.column(name).to_pylist()) == repr(table.column(name).to_pylist())
    assert out.column("half").to_pylist() == [0.5, 1.0, 1.5]


def test_parquet_leaves_as_csv_with_empty_cells_where_there_is_nothing(tmp_path: Path) -> None:
    columns = {
        "X": pyarrow.array([1.5, 2.0]),
        "Z": pyarrow.array([1, 2]),
        "n": pyarrow.array([None, 9007199254740993]),
        "at": pyarrow.array([datetime(2026, 1, 2, 3, 4, 5), None], pyarrow.timestamp("ms")),
        "text": pyarrow.array(['a, "b"', None]),
    }
    pyarrow.parquet.write_table(pyarrow.table(columns), tmp_path / "in.parquet")
    stream(tmp_path / "in.parquet", tmp_path / "out.csv")
    with (tmp_path / "out.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[1] == ["1.5", "1", "", "2026-01-02 03:04:05.000", 'a, "b"', "3.0", "0.5"]
    assert rows[2][2:] == ["9007199254740993", "", "", "4.0", "1.0"]


def test_csv_text_stays_text_in_parquet_and_comes_back(tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text("X,Z,n\n1.50,2,007\n3,4,2026-01-01\n")
    stream(tmp_path / "in.csv", tmp_path / "out.parquet")
    out = pyarrow.parquet.read_table(tmp_path / "out.parquet")
    assert out.column("n").to_pylist() == ["007", "2026-01-01"]
    transform(tmp_path / "out.parquet", tmp_path / "back.csv", (), lambda _: {}, "copying")
    with (tmp_path / "back.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert [row[:3] for row in rows] == [["X", "Z", "n"], ["1.50", "2", "007"], ["3", "4", "2026-01-01"]]


@pytest.mark.parametrize(("first", "second"), [("csv", "csv"), ("parquet", "csv"), ("parquet", "parquet")])
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=st.lists(st.floats(allow_nan=False), min_size=1, max_size=20))
def test_numbers_keep_all_their_digits(tmp_path: Path, first: str, second: str, values: list[float]) -> None:
    given_values = np.array(values)
    write_table(tmp_path / f"a.{first}", {"X": given_values})
    copy = {"again": given_values}
    transform(tmp_path / f"a.{first}", tmp_path / f"b.{second}", ["X"], lambda _: copy, "copying")
    table = read_table(tmp_path / f"b.{second}").numbers
    assert table["X"].tobytes() == given_values.tobytes()
    assert table["again"].tobytes() == given_values.tobytes()


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_table_without_rows_gives_one_without_rows(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "in.csv").write_text("X,Z\n\n")
    assert stream(tmp_path / "in.csv", tmp_path / f"one.{suffix}") == 0
    assert transform(tmp_path / f"one.{suffix}", tmp_path / f"two.{suffix}", ["X"], lambda _: {}, "copying") == 0
    table = read_table(tmp_path / f"two.{suffix}")
    assert len(table) == 0
    assert list(table.numbers) == ["X", "Z", "X2", "half"]


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_position_in_a_later_chunk_is_named_by_its_row_in_the_file(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"in.{suffix}"
    write_table(path, {a: np.where(np.arange(20) == 17, 9999.0, 1.0) if a == "Y" else np.ones(20) for a in "XYZ"})
    with open_table(path, chunk_rows=7) as reader:
        chunks = [coordinates(chunk, MACHINE) for chunk, _ in zip(reader.chunks(), range(2), strict=False)]
        assert list(map(len, chunks)) == [7, 7]
    message = "axis 'Y' must lie within -250 and 250 mm, got 9999 in row 18 of"
    with pytest.raises(DataError, match=message):
        transform(path, tmp_path / "out.csv", "XYZ", lambda c: {"q": coordinates(c, MACHINE)[:, 0]}, "", chunk_rows=7)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"X,Z\n" + b"1,2\n" * 11 + b"1,b\n", "'.*in.csv', row 12: column 'Z' must be a number, got 'b'"),
        (b"X,Z\n" + b"1,2\n\n" * 5 + b"a,2\n", "'.*in.csv', row 6: column 'X' must be a number, got 'a'"),
        (b"X,Z\n" + b"1,2\n" * 11 + b"1,2,3\n", "'.*in.csv', line 13: must have 2 cells, got 3"),
        (b'X,Z\n1,"2\n"\n' + b"1,2\n\n" * 3 + b"1\n", "'.*in.csv', line 10: must have 2 cells, got 1"),
        (b'X,Z\n1,2\n1,2\n1,"2\n3,4\n', "'.*in.csv', line 5: is not CSV: unexpected end of data"),
        (b"X,Z\n1,2\n1,\xb5\n", "'.*in.csv' must be UTF-8 text, got byte 0xb5 in line 3; save it as UTF-8"),
        (b"X,Y\n1,2\n", "'.*in.csv' must have a column 'Z', got X, Y"),
        (b"X,Z,Z\n1,2,3\n", "'.*in.csv' must have each column once, got X, Z, Z"),
        (b"X,Z,half\n1,2,3\n", "'.*in.csv' must not have a column 'half', which the output adds; rename it"),
        (b"", "'.*in.csv' must have a column 'X', got none"),
    ],
)
def test_a_wrong_csv_gets_one_sentence_and_leaves_no_output(tmp_path: Path, text: bytes, message: str) -> None:
    (tmp_path / "in.csv").write_bytes(text)
    with pytest.raises(DataError, match=message):
        stream(tmp_path / "in.csv", tmp_path / "out.csv", 3)
    assert [p.name for p in tmp_path.iterdir()] == ["in.csv"]


def test_a_wrong_parquet_gets_one_sentence(tmp_path: Path) -> None:
    path, out = tmp_path / "in.parquet", tmp_path / "out.csv"
    path.write_bytes(b"PAR1")
    with pytest.raises(DataError, match=r"'.*in.parquet' is not a Parquet file: "):
        stream(path, out)
    times = pyarrow.array([datetime(2026, 1, 1)] * 2)
    pyarrow.parquet.write_table(pyarrow.table({"X": times, "Z": [1, 2]}), path)
    with pytest.raises(DataError, match=r"'.*in.parquet': column 'X' must be numbers, got timestamp\[us\]"):
        stream(path, out)
    write_table(path, {"X": ["1", "a"], "Z": np.ones(2)})
    with pytest.raises(DataError, match=r"'.*in.parquet', row 2: column 'X' must be a number, got 'a'"):
        stream(path, out)
    pyarrow.parquet.write_table(pyarrow.table({"X": [1, 2], "Z": [1, 2], "deep": [[1], [2]]}), path)
    with pytest.raises(DataError, match=r"'.*in.parquet': column 'deep' must have a form in text, got list"):
        stream(path, out)
    many(tmp_path, 50_000, "parquet").rename(path)
    data = path.read_bytes()
    path.write_bytes(data[:200] + bytes(len(data) // 2) + data[200 + len(data) // 2 :])
    with pytest.raises(DataError, match=r"'.*in.parquet' cannot be read after row \d+: "):
        stream(path, out)
    assert [p.name for p in tmp_path.iterdir()] == ["in.parquet"]


def test_an_output_that_cannot_be_written_gets_one_sentence(tmp_path: Path) -> None:
    source = many(tmp_path, 3)
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "link.csv").hardlink_to(source)
    for out, message in (
        ("many.csv", "the output '.*many.csv' must not be one of the inputs, got the file read as '.*many.csv'"),
        ("link.csv", "the output '.*link.csv' must not be one of the inputs, got the file read as '.*many.csv'"),
        ("folder.csv", "'.*folder.csv' cannot be written: it is a folder"),
        ("none/out.csv", "'.*out.csv' cannot be written: No such file or directory"),
        ("out.xlsx", "'.*out.xlsx' must end in .parquet or .csv, got '.xlsx'"),
    ):
        with pytest.raises(DataError, match=message):
            stream(source, tmp_path / out)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@pytest.mark.parametrize("problem", [KeyboardInterrupt, RuntimeError])
def test_work_that_stops_leaves_an_existing_output_as_it_was(
    tmp_path: Path, suffix: str, problem: type[BaseException]
) -> None:
    source, out = many(tmp_path, 50), tmp_path / f"out.{suffix}"
    out.write_text("before")

    def stop(chunk: Chunk) -> Mapping[str, np.ndarray]:
        if chunk.first >= 30:
            raise problem
        return doubled(chunk)

    with pytest.raises(problem):
        transform(source, out, ["X"], stop, "stopping", chunk_rows=7)
    assert out.read_text() == "before"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["many.csv", out.name]


def test_a_link_stays_a_link_and_the_file_keeps_its_mode(tmp_path: Path) -> None:
    source, real, link = many(tmp_path, 3), tmp_path / "real.csv", tmp_path / "link.csv"
    real.write_text("before")
    real.chmod(0o640)
    link.symlink_to(real)
    stream(source, link)
    assert link.is_symlink()
    assert real.read_text().startswith("X,Y,Z,X2,half\n")
    assert real.stat().st_mode & 0o777 == 0o640


def test_a_full_disk_gets_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import model.streams

    class Full(model.streams.CsvWriter):
        def write(self, chunk: Chunk, added: Mapping[str, np.ndarray]) -> None:
            raise OSError(28, os.strerror(28))

    source = many(tmp_path, 3)
    monkeypatch.setattr(model.streams, "CsvWriter", Full)
    with pytest.raises(DataError, match="'.*out.csv' cannot be written: No space left on device"):
        stream(source, tmp_path / "out.csv")
    assert [p.name for p in tmp_path.iterdir()] == ["many.csv"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "machine.toml").write_text(machine_text())
    (tmp_path / "errors.csv").write_text(ERRORS)
    return tmp_path


def command(name: str, positions: str, out: str) -> list[str]:
    return [THERMOTRUE, name, "machine.toml", "--errors", "errors.csv", "--positions", positions, "--out", out]


LISTENING = "import os, signal, sys; signal.signal(signal.SIGINT, signal.SIG_DFL); os.execvp(sys.argv[1], sys.argv[1:])"
"""Runs a command that listens to Ctrl-C, even where the tests run in the background and ignore it."""


def test_ctrl_c_leaves_nothing_half_written(folder: Path) -> None:
    (folder / "long.csv").write_bytes(b"X,Y,Z\n" + b"100.001,50.002,20.003\n" * 2_000_000)  # some seconds' work
    before = {p.name for p in folder.iterdir()}
    listening = [sys.executable, "-c", LISTENING, *command("compensate", "long.csv", "out.csv")]
    with subprocess.Popen(listening, cwd=folder, stderr=subprocess.PIPE) as process:
        part = None
        while part is None and process.poll() is None:  # until rows are being written
            time.sleep(0.02)
            part = next((p for p in folder.glob(".out.csv.*.part") if p.stat().st_size), None)
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=30)
    assert (process.returncode, stderr.strip()) == (130, b"thermotrue: interrupted")
    assert {p.name for p in folder.iterdir()} == before


def test_positions_that_leave_the_range_are_counted_over_all_chunks(folder: Path) -> None:
    (folder / "errors.csv").write_text("term,position,value\nEXX,0,-5\n")
    x = np.full(12_000, 5.0)
    x[[5000, 9000, 11_999]] = 0.0
    write_table(folder / "p.csv", {"X": x, "Y": 0 * x, "Z": 0 * x})
    done = subprocess.run(
        command("compensate", "p.csv", "out.csv"), cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.stdout == "12000 positions written to out.csv\n"
    assert done.stderr == (
        "warning: 3 corrected positions leave an axis' range, the first in row 5001; they are written as they are\n"
    )


def test_the_error_table_is_not_overwritten(folder: Path) -> None:
    write_table(folder / "p.csv", {a: np.ones(2) for a in "XYZ"})
    done = subprocess.run(
        command("deviation", "p.csv", "errors.csv"), cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.startswith("thermotrue: the output 'errors.csv' must not be one of the inputs")
    assert (folder / "errors.csv").read_text() == ERRORS


WITHOUT_PYARROW = """
import sys
sys.modules["pyarrow"] = None
from model.cli import main
main()
"""


def test_csv_needs_no_pyarrow_and_parquet_says_what_does(folder: Path) -> None:
    write_table(folder / "p.csv", {a: np.ones(2) for a in "XYZ"})
    for out, code, message in (
        ("out.csv", 0, ""),
        (
            "out.parquet",
            2,
            "thermotrue: 'out.parquet' is Parquet, which needs the train extra; install it or use CSV\n",
        ),
    ):
        arguments = command("deviation", "p.csv", out)[1:]
        done = subprocess.run(
            [sys.executable, "-c", WITHOUT_PYARROW, *arguments], cwd=folder, capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stderr) == (code, message)
        assert (folder / out).exists() == (code == 0)


PEAK = """
import sys
from pathlib import Path
from model.streams import transform
transform(sys.argv[1], sys.argv[2], ["X"], lambda chunk: {"X2": 2 * chunk.numbers("X")}, "doubling")
print(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])
"""


@pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="peak memory of the process itself is Linux' to tell"
)
@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_memory_does_not_grow_with_the_number_of_positions(tmp_path: Path, suffix: str) -> None:
    """`ru_maxrss` would not do: it starts at the size of the process that forked this one."""
    peaks_mb = []
    for rows in (300_000, 1_200_000):
        source = many(tmp_path, rows, suffix) if suffix == "parquet" else tmp_path / "in.csv"
        if suffix == "csv":
            source.write_bytes(b"X,Y,Z\n" + b"100.001,50.002,20.003\n" * rows)
        run = [sys.executable, "-c", PEAK, str(source), str(tmp_path / f"out.{suffix}")]
        done = subprocess.run(run, capture_output=True, text=True, check=True)
        peaks_mb.append(int(done.stdout) / 1024)
    assert peaks_mb[1] - peaks_mb[0] < 30, peaks_mb


def test_an_unfinished_table_of_one_writer_does_not_disturb_another(tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    with create_table(out):
        write_table(out, {"X": np.ones(1)})
        assert out.read_text() == "X\n1.0\n"
    assert out.read_text() == ""
