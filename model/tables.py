"""Tables in files that fit into memory, CSV or Parquet, told apart by the ending."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.csv_stream import csv_lines
from model.streams import SUFFIXES, create_table, open_table
from model.transforms import Array


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


def read_table(
    path: str | Path, required: Sequence[str] = (), text: Sequence[str] = ("run",), content: bytes | None = None
) -> Table:
    """Read a table; columns named in `text` stay text, the others must be numbers.

    Where `content`, the bytes of a CSV file, is given, `path` only names it.

    Raises
    ------
    DataError
        where the file cannot be read, a required column is missing or a cell is not a number.
    """
    with open_table(path, required, content=content) as reader:
        numbers: dict[str, list[Array]] = {name: [] for name in reader.names if name not in text}
        strings: dict[str, list[str]] = {name: [] for name in reader.names if name in text}
        for chunk in reader.chunks():
            for name, parts in numbers.items():
                parts.append(chunk.numbers(name))
            for name, cells in strings.items():
                cells.extend(chunk.text(name))
    return Table(
        str(path),
        {name: np.concatenate(parts) for name, parts in numbers.items()},
        {name: np.asarray(cells, dtype=str) for name, cells in strings.items()},
    )


def write_table(path: str | Path, columns: Mapping[str, Sequence[Any] | NDArray[Any]]) -> None:
    """Write columns of one length, arrays or lists of text, as CSV or Parquet; numbers keep all their digits."""
    with create_table(path) as writer:
        writer.write(_Columns(columns), {})


@dataclass(frozen=True)
class _Columns:
    """Columns in memory, as something to write."""

    _columns: Mapping[str, Sequence[Any] | NDArray[Any]]
    schema: None = None

    def __len__(self) -> int:
        return max(map(len, self._columns.values()), default=0)

    @property
    def names(self) -> list[str]:
        return list(self._columns)

    def columns(self) -> dict[str, Any]:
        return dict(self._columns)

    def lines(self) -> list[str]:
        cells = [c.tolist() if isinstance(c, np.ndarray) else c for c in self._columns.values()]
        return csv_lines(zip(*cells, strict=True))
