"""Tables in files, CSV or Parquet, told apart by the ending."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.exceptions import DataError
from model.transforms import Array

SUFFIXES = (".parquet", ".csv")


@dataclass(frozen=True)
class Table:
    """Columns of a file.

    Attributes
    ----------
    source : the file, for messages
    numbers : columns of numbers, NaN where a cell is empty
    text : columns of text
    """

    source: str
    numbers: dict[str, Array]
    text: dict[str, NDArray[np.str_]]

    def __len__(self) -> int:
        return max((len(c) for c in [*self.numbers.values(), *self.text.values()]), default=0)


def find_table(folder: Path, name: str) -> Path | None:
    """Return the file `name` with one of the known endings in a folder, or None."""
    for suffix in SUFFIXES:
        if (folder / (name + suffix)).is_file():
            return folder / (name + suffix)
    return None


def read_table(path: str | Path, required: Sequence[str] = (), text: Sequence[str] = ("run",)) -> Table:
    """Read a table; columns named in `text` stay text, the others must be numbers.

    Raises
    ------
    DataError
        where the file cannot be read, a required column is missing or a cell is not a number.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise DataError(f"'{path}' must end in {' or '.join(SUFFIXES)}, got '{path.suffix}'")
    if not path.is_file():
        raise DataError(f"'{path}' cannot be read: there is no such file")
    numbers, strings = _read_csv(path, text) if path.suffix == ".csv" else _read_parquet(path, text)
    for column in required:
        if column not in numbers and column not in strings:
            have = ", ".join([*strings, *numbers])
            raise DataError(f"'{path}' must have a column '{column}', got {have or 'none'}")
    return Table(str(path), numbers, strings)


def write_table(path: str | Path, columns: Mapping[str, Sequence[Any] | NDArray[Any]]) -> None:
    """Write columns of one length as CSV or Parquet; numbers keep all their digits."""
    path = Path(path)
    if path.suffix == ".csv":
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(zip(*(_cells(c) for c in columns.values()), strict=True))
    elif path.suffix == ".parquet":
        pyarrow, parquet = _pyarrow(path)
        parquet.write_table(pyarrow.table({name: pyarrow.array(c) for name, c in columns.items()}), path)
    else:
        raise DataError(f"'{path}' must end in {' or '.join(SUFFIXES)}, got '{path.suffix}'")


def _cells(column: Sequence[Any] | NDArray[Any]) -> Iterable[Any]:
    return column.tolist() if isinstance(column, np.ndarray) else column


def _read_csv(path: Path, text: Sequence[str]) -> tuple[dict[str, Array], dict[str, NDArray[np.str_]]]:
    with path.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.reader(file)
        header = [name.strip() for name in next(reader, [])]
        if len(set(header)) != len(header):
            raise DataError(f"'{path}' must have each column once, got {', '.join(header)}")
        columns: list[list[str]] = [[] for _ in header]
        for number, row in enumerate(reader, start=2):
            if not row:
                continue
            if len(row) != len(header):
                raise DataError(f"'{path}', line {number}: must have {len(header)} cells, got {len(row)}")
            for column, cell in zip(columns, row, strict=True):
                column.append(cell.strip())
    numbers = {n: _floats(c, path, n) for n, c in zip(header, columns, strict=True) if n not in text}
    strings = {n: np.asarray(c, dtype=str) for n, c in zip(header, columns, strict=True) if n in text}
    return numbers, strings


def _floats(cells: list[str], path: Path, column: str) -> Array:
    try:
        return np.array([float(cell) if cell else np.nan for cell in cells])
    except ValueError:
        for row, cell in enumerate(cells, start=1):
            try:
                float(cell or "nan")
            except ValueError:
                raise DataError(f"'{path}', row {row}: column '{column}' must be a number, got {cell!r}") from None
        raise


def _read_parquet(path: Path, text: Sequence[str]) -> tuple[dict[str, Array], dict[str, NDArray[np.str_]]]:
    pyarrow, parquet = _pyarrow(path)
    try:
        table = parquet.read_table(path)
    except (pyarrow.ArrowException, OSError) as problem:
        raise DataError(f"'{path}' is not a Parquet file: {problem}") from None
    numbers: dict[str, Array] = {}
    strings: dict[str, NDArray[np.str_]] = {}
    for name in table.column_names:
        column = table.column(name)
        if name in text:
            strings[name] = np.asarray(column.cast(pyarrow.string()).to_pylist(), dtype=str)
            continue
        try:
            numbers[name] = np.asarray(column.cast(pyarrow.float64()).to_numpy(), dtype=float)
        except pyarrow.ArrowException:
            raise DataError(f"'{path}': column '{name}' must be numbers, got {column.type}") from None
    return numbers, strings


def _pyarrow(path: Path) -> tuple[Any, Any]:
    try:
        import pyarrow  # noqa: PLC0415 (not in the base install)
        import pyarrow.parquet  # noqa: PLC0415
    except ImportError:
        raise DataError(f"'{path}' is Parquet, which needs the train extra; install it or use CSV") from None
    return pyarrow, pyarrow.parquet
