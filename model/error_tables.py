"""Error tables as files: columns `term`, `position` (empty for location terms), `value` [µm or µrad]."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

from model.error_map import Row
from model.exceptions import DataError
from model.tables import read_table

COLUMNS = ("term", "position", "value")


def read_error_table(path: str | Path, content: bytes | None = None) -> list[Row]:
    """Read an error table from CSV or Parquet.

    Where `content`, the bytes of a CSV file, is given, `path` only names it.

    Raises
    ------
    DataError
        where the file cannot be read, lacks a column or a value is not a number.
    """
    table = read_table(path, required=COLUMNS, text=("term",), content=content)
    terms = table.text["term"]
    positions, values = table.numbers["position"], table.numbers["value"]
    return [
        (str(term), None if position != position else float(position), float(value))  # noqa: PLR0124 (NaN)
        for term, position, value in zip(terms, positions, values, strict=True)
    ]


def write_error_table(path: str | Path, rows: Iterable[Row]) -> None:
    """Write an error table as CSV; values keep all their digits."""
    try:
        with Path(path).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            for term, position, value in rows:
                writer.writerow([term, "" if position is None else repr(position), repr(value)])
    except OSError as problem:
        raise DataError(f"'{path}' cannot be written: {problem.strerror}") from None
