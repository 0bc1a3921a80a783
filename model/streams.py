"""Tables of any length: read, computed with and written chunk by chunk, so that memory does not grow with them."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from secrets import token_hex
from typing import Any, BinaryIO, Protocol

from model.csv_stream import CsvReader, CsvWriter
from model.exceptions import DataError
from model.parquet_stream import ParquetReader, ParquetWriter
from model.progress import Reporter
from model.transforms import Array

SUFFIXES = (".parquet", ".csv")
CHUNK_ROWS = 4096
"""Rows worked on at once: so few that their text stays near the processor, which makes CSV a fifth faster than with
16384, and so many that a chunk's fixed cost does not count."""


class Chunk(Protocol):
    """Consecutive rows of a table."""

    @property
    def source(self) -> str:
        """The file, for messages."""

    @property
    def names(self) -> list[str]:
        """The columns."""

    @property
    def first(self) -> int:
        """How many rows of the table come before."""

    @property
    def schema(self) -> Any:
        """The columns' types as a pyarrow.Schema, None where the file has none."""

    def __len__(self) -> int: ...

    def numbers(self, column: str) -> Array:
        """Return a column as numbers, NaN where a cell is empty, shape (n,)."""

    def text(self, column: str) -> list[str]:
        """Return a column as text."""

    def columns(self) -> dict[str, Any]:
        """Return all columns: lists of text, or Arrow or NumPy arrays."""

    def lines(self) -> list[str]:
        """Return the rows as lines of CSV without line ends."""


Reader = CsvReader | ParquetReader
Writer = CsvWriter | ParquetWriter
Compute = Callable[[Chunk], Mapping[str, Array]]


@contextmanager
def open_table(
    path: str | Path, required: Sequence[str] = (), chunk_rows: int = CHUNK_ROWS, content: bytes | None = None
) -> Iterator[Reader]:
    """Open a table for reading by chunks.

    Parameters
    ----------
    content : bytes of a CSV file that `path` then only names

    Raises
    ------
    DataError
        where the file cannot be read or does not have each of the required columns, and any other one, once.
    """
    path = Path(path)
    _check_suffix(path)
    if content is None and not path.is_file():
        raise DataError(f"'{path}' cannot be read: there is no such file")
    try:
        reader: Reader = (
            CsvReader(path, chunk_rows, content) if path.suffix == ".csv" else ParquetReader(path, chunk_rows)
        )
    except OSError as problem:
        raise DataError(f"'{path}' cannot be read: {problem.strerror}") from None
    with closing(reader):
        have = ", ".join(reader.names)
        if len(set(reader.names)) != len(reader.names):
            raise DataError(f"'{path}' must have each column once, got {have}")
        for column in required:
            if column not in reader.names:
                raise DataError(f"'{path}' must have a column '{column}', got {have or 'none'}")
        yield reader


@contextmanager
def create_table(path: str | Path) -> Iterator[Writer]:
    """Open a table for writing by chunks.

    The rows go to a file beside it that takes its name at the end. So an existing table stays as it is until a
    complete one replaces it, and work that fails or is interrupted leaves nothing behind.

    Raises
    ------
    DataError
        where the file cannot be written.
    """
    path = Path(path)
    _check_suffix(path)
    if path.is_dir():
        raise DataError(f"'{path}' cannot be written: it is a folder")
    target = path.resolve()  # where a link leads, and not the link, is replaced
    part = target.with_name(f".{target.name}.{token_hex(4)}.part")
    try:
        with part.open("xb") as file, closing(_writer(path, file)) as writer:
            yield writer
        if target.exists():
            shutil.copymode(target, part)
        part.replace(target)
    except BrokenPipeError:  # whoever read our messages is gone; the table is not at fault
        raise
    except OSError as problem:
        raise DataError(f"'{path}' cannot be written: {problem.strerror or problem}") from None
    finally:
        part.unlink(missing_ok=True)


def transform(
    source: str | Path,
    out: str | Path,
    required: Sequence[str],
    compute: Compute,
    what: str,
    keep: Sequence[str | Path] = (),
    chunk_rows: int = CHUNK_ROWS,
) -> int:
    """Write a table with columns of numbers added to each row, and show how far it is.

    Parameters
    ----------
    required : columns that the table must have
    compute : returns the columns to add to a chunk, each of shape (n,)
    what : the work, in a word
    keep : further files that the work reads

    Returns
    -------
    the number of rows

    Raises
    ------
    DataError
        where a file cannot be read or written, the output is one of the inputs, or a column to add is there already.
    """
    for path in (source, *keep):
        if Path(out).exists() and Path(path).exists() and Path(out).samefile(path):
            raise DataError(f"the output '{out}' must not be one of the inputs, got the file read as '{path}'")
    rows = 0
    with open_table(source, required, chunk_rows) as reader, create_table(out) as writer, Reporter(what, 0) as reporter:
        for chunk in reader.chunks():
            added = compute(chunk)
            for name in added:
                if name in chunk.names:
                    raise DataError(
                        f"'{source}' must not have a column '{name}', which the output adds; rename it or take it out"
                    )
            writer.write(chunk, added)
            rows += len(chunk)
            reporter.at(rows, max(reader.rows_expected(), rows), reader.unit)
    return rows


def _writer(path: Path, file: BinaryIO) -> Writer:
    return CsvWriter(file) if path.suffix == ".csv" else ParquetWriter(file, str(path))


def _check_suffix(path: Path) -> None:
    if path.suffix not in SUFFIXES:
        raise DataError(f"'{path}' must end in {' or '.join(SUFFIXES)}, got '{path.suffix}'")
