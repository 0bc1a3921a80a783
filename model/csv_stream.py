"""CSV in chunks, with the standard library and NumPy alone.

A row is carried as the text it came as, so that columns nobody computes with leave exactly as they entered; only the
columns asked for become numbers. Numbers are written with the fewest digits that read back as the same double.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO, TextIOWrapper
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO

import numpy as np
from pydantic_core import to_json

from model.exceptions import DataError
from model.transforms import Array


@dataclass(frozen=True)
class CsvChunk:
    """Consecutive rows of a CSV file.

    Attributes
    ----------
    source : the file, for messages
    names : its columns
    first : how many rows of the file come before
    rows : cells, shape (n, columns)
    records : the same rows as they stand in the file, line ends included
    """

    source: str
    names: list[str]
    first: int
    rows: list[list[str]]
    records: list[str]
    schema: None = None

    def __len__(self) -> int:
        return len(self.rows)

    def numbers(self, column: str) -> Array:
        """Return a column as numbers, NaN where a cell is empty, shape (n,)."""
        at = self.names.index(column)
        return floats([row[at] for row in self.rows], self.source, column, self.first)

    def text(self, column: str) -> list[str]:
        """Return a column as text, without the blanks around it."""
        at = self.names.index(column)
        return [row[at].strip() for row in self.rows]

    def columns(self) -> dict[str, Any]:
        """Return all columns as lists of cells."""
        return {name: [row[at] for row in self.rows] for at, name in enumerate(self.names)}

    def lines(self) -> list[str]:
        """Return the rows as they stand in the file, without line ends."""
        return [record.rstrip("\r\n") for record in self.records]


class CsvReader:
    """Reads a CSV file chunk by chunk.

    Parameters
    ----------
    path : names the file in messages
    chunk_rows : rows of a chunk; the last one is shorter
    content : the file's bytes, where they are at hand; None reads them from `path`
    """

    unit = "rows (total estimated)"

    def __init__(self, path: Path, chunk_rows: int, content: bytes | None = None) -> None:
        self.source, self._chunk_rows = str(path), chunk_rows
        self._bytes: BinaryIO = path.open("rb") if content is None else BytesIO(content)
        self._file = TextIOWrapper(self._bytes, encoding="utf-8-sig", newline="")
        self._size, self._rows_read = path.stat().st_size if content is None else len(content), 0
        self._taken: list[str] = []
        self._reader = csv.reader(self._recorded(), strict=True)
        try:
            header = self._next(1)
        except DataError:
            self.close()
            raise
        self.names = [name.strip() for name in header[0]] if header else []

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def rows_expected(self) -> int:
        """Return how many rows the file has, estimated from the bytes of those already read."""
        return round(self._rows_read * self._size / max(self._bytes.tell(), 1))

    def chunks(self) -> Iterator[CsvChunk]:
        """Yield the rows in order; a file without rows is one chunk without rows."""
        self._taken.clear()
        line = self._reader.line_num + 1
        while rows := self._next(self._chunk_rows):
            records = self._records(len(rows))
            if any(len(row) != len(self.names) for row in rows):
                self._check_widths(rows, records, line)
                records = [record for record, row in zip(records, rows, strict=True) if row]  # blank lines are no rows
                rows = [row for row in rows if row]
            first, self._rows_read = self._rows_read, self._rows_read + len(rows)
            if rows:
                yield CsvChunk(self.source, self.names, first, rows, records)
            self._taken.clear()
            line = self._reader.line_num + 1
        if not self._rows_read:
            yield CsvChunk(self.source, self.names, 0, [], [])

    def _recorded(self) -> Iterator[str]:
        """Yield the file's lines and keep what `csv` took; it takes no more than the rows it gives."""
        for line in self._file:
            self._taken.append(line)
            yield line

    def _next(self, rows: int) -> list[list[str]]:
        try:
            return list(islice(self._reader, rows))
        except csv.Error as problem:
            raise DataError(f"'{self.source}', line {self._reader.line_num}: is not CSV: {problem}") from None
        except UnicodeDecodeError:
            raise DataError(
                f"'{self.source}' must be UTF-8 text, got {self._undecodable()}; save it as UTF-8"
            ) from None
        except OSError as problem:
            raise DataError(f"'{self.source}' cannot be read: {problem.strerror}") from None

    def _undecodable(self) -> str:
        """Return which byte is not UTF-8 and where; text is decoded ahead, so that the reader's line is not its."""
        self._bytes.seek(0)
        for number, line in enumerate(self._bytes, start=1):
            try:
                line.decode()
            except UnicodeDecodeError as problem:
                return f"byte 0x{line[problem.start]:02x} in line {number}"
        return "something else"

    def _records(self, rows: int) -> list[str]:
        """Return the text of each row; rows with line ends within quotes are several lines."""
        if len(self._taken) == rows:
            return self._taken.copy()
        again = csv.reader(self._taken)
        ends = [again.line_num for _ in again]
        return ["".join(self._taken[a:b]) for a, b in zip([0, *ends], ends, strict=False)]

    def _check_widths(self, rows: list[list[str]], records: list[str], line: int) -> None:
        for row, record in zip(rows, records, strict=True):
            if row and len(row) != len(self.names):
                raise DataError(f"'{self.source}', line {line}: must have {len(self.names)} cells, got {len(row)}")
            line += record.rstrip("\r\n").count("\n") + 1


class CsvWriter:
    """Writes chunks with added columns of numbers as CSV."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._begun = file, False

    def write(self, chunk: Any, added: Mapping[str, Array]) -> None:
        """Append rows; the first ones bring the header."""
        if not self._begun:
            self._put(csv_lines([[*chunk.names, *added]]))
            self._begun = True
        if added and len(chunk):
            # pydantic's shortest digits that read back exactly, several times faster than Python's `repr`
            numbers = to_json(np.stack(list(added.values()), axis=1).tolist(), inf_nan_mode="constants").decode()
            self._put([f"{a},{b}" for a, b in zip(chunk.lines(), numbers[2:-2].split("],["), strict=True)])
        else:
            self._put(chunk.lines())

    def close(self) -> None:
        """Finish; CSV needs nothing."""

    def _put(self, lines: list[str]) -> None:
        self._file.write("".join([f"{line}\n" for line in lines]).encode())


def csv_lines(rows: Iterable[Sequence[Any]]) -> list[str]:
    """Return rows as lines of CSV, quoted where they must be, without line ends."""
    lines: list[str] = []
    csv.writer(SimpleNamespace(write=lines.append), lineterminator="").writerows(rows)
    return lines


def floats(cells: Sequence[str | None], source: str, column: str, first: int) -> Array:
    """Return cells as numbers, NaN where one is empty; `first` rows of the source come before them.

    Raises
    ------
    DataError
        naming the first row whose cell is not a number.
    """
    try:
        return np.fromiter(map(float, cells), float, len(cells))  # type: ignore[arg-type]
    except (ValueError, TypeError):
        values = np.full(len(cells), np.nan)
    for row, cell in enumerate(cells):
        if cell is None or not cell.strip():
            continue
        try:
            values[row] = float(cell)
        except ValueError:
            raise DataError(
                f"'{source}', row {first + row + 1}: column '{column}' must be a number, got {cell.strip()!r}"
            ) from None
    return values
