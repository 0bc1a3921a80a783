"""Parquet in chunks, through pyarrow, which only the train extra brings: imported when a Parquet file is named."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from model.csv_stream import csv_lines, floats
from model.exceptions import DataError
from model.transforms import Array

ROW_GROUP = 131072
"""Rows of a row group: readers want large ones, and these wait in memory, 10 MB for ten columns."""


@dataclass(frozen=True)
class ParquetChunk:
    """Consecutive rows of a Parquet file.

    Attributes
    ----------
    source : the file, for messages
    first : how many rows of the file come before
    batch : the rows, a pyarrow.RecordBatch
    """

    source: str
    first: int
    batch: Any

    def __len__(self) -> int:
        return int(self.batch.num_rows)

    @property
    def names(self) -> list[str]:
        """The columns."""
        return list(self.batch.schema.names)

    @property
    def schema(self) -> Any:
        """The columns' types and the file's metadata, a pyarrow.Schema."""
        return self.batch.schema

    def numbers(self, column: str) -> Array:
        """Return a column as numbers, NaN where a cell is empty, shape (n,)."""
        pyarrow, _ = import_pyarrow(self.source)
        cells = self.batch.column(column)
        if pyarrow.types.is_dictionary(cells.type):
            cells = cells.dictionary_decode()
        if pyarrow.types.is_string(cells.type) or pyarrow.types.is_large_string(cells.type):
            return floats(cells.to_pylist(), self.source, column, self.first)
        try:
            return np.asarray(cells.cast(pyarrow.float64()).to_numpy(zero_copy_only=False), dtype=float)
        except pyarrow.ArrowException:
            raise DataError(f"'{self.source}': column '{column}' must be numbers, got {cells.type}") from None

    def text(self, column: str) -> list[str]:
        """Return a column as text, empty where a cell is."""
        pyarrow, _ = import_pyarrow(self.source)
        cells = self.batch.column(column)
        try:
            return ["" if cell is None else cell for cell in cells.cast(pyarrow.string()).to_pylist()]
        except pyarrow.ArrowException:
            raise DataError(
                f"'{self.source}': column '{column}' must have a form in text, got {cells.type}; leave it out or "
                "write Parquet"
            ) from None

    def columns(self) -> dict[str, Any]:
        """Return all columns as Arrow arrays."""
        return dict(zip(self.names, self.batch.columns, strict=True))

    def lines(self) -> list[str]:
        """Return the rows as lines of CSV."""
        return csv_lines(zip(*map(self.text, self.names), strict=True))


class ParquetReader:
    """Reads a Parquet file chunk by chunk.

    Parameters
    ----------
    chunk_rows : rows of a chunk at most
    """

    unit = "rows"

    def __init__(self, path: Path, chunk_rows: int) -> None:
        self.source, self._chunk_rows = str(path), chunk_rows
        self._pyarrow, parquet = import_pyarrow(self.source)
        try:
            # Buffered and not fetched ahead, so that memory does not grow with the file.
            self._file = parquet.ParquetFile(path, pre_buffer=False, buffer_size=1 << 20)
        except (self._pyarrow.ArrowException, OSError) as problem:
            raise DataError(f"'{path}' is not a Parquet file: {problem}") from None
        self.names = list(self._file.schema_arrow.names)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def rows_expected(self) -> int:
        """Return how many rows the file has."""
        return int(self._file.metadata.num_rows)

    def chunks(self) -> Iterator[ParquetChunk]:
        """Yield the rows in order; a file without rows is one chunk without rows."""
        first = 0
        try:
            for batch in self._file.iter_batches(self._chunk_rows, use_threads=False):
                whole = self._pyarrow.RecordBatch.from_arrays(batch.columns, schema=self._file.schema_arrow)
                yield ParquetChunk(self.source, first, whole)
                first += batch.num_rows
        except (self._pyarrow.ArrowException, OSError) as problem:
            raise DataError(f"'{self.source}' cannot be read after row {first}: {problem}") from None
        if not first:
            schema = self._file.schema_arrow
            none = [self._pyarrow.array([], field.type) for field in schema]
            yield ParquetChunk(self.source, 0, self._pyarrow.RecordBatch.from_arrays(none, schema=schema))


class ParquetWriter:
    """Writes chunks with added columns of numbers as Parquet; text that comes from CSV stays text."""

    def __init__(self, file: BinaryIO, target: str) -> None:
        self._file, self._writer = file, None
        self._pyarrow, self._parquet = import_pyarrow(target)
        self._pending: list[Any] = []

    def write(self, chunk: Any, added: Mapping[str, Array]) -> None:
        """Append rows; the first ones bring the schema."""
        pyarrow = self._pyarrow
        arrays = [pyarrow.array(c, pyarrow.string()) if isinstance(c, list) else c for c in chunk.columns().values()]
        arrays = [pyarrow.array(c) if isinstance(c, np.ndarray) else c for c in [*arrays, *added.values()]]
        if self._writer is None:
            carried = chunk.schema or pyarrow.schema(
                [(n, a.type) for n, a in zip(chunk.names, arrays[: len(chunk.names)], strict=True)]
            )
            fields = [*carried, *(pyarrow.field(name, pyarrow.float64()) for name in added)]
            self._schema = pyarrow.schema(fields, metadata=carried.metadata)
            self._writer = self._parquet.ParquetWriter(self._file, self._schema)
        self._pending.append(pyarrow.RecordBatch.from_arrays(arrays, schema=self._schema))
        if sum(batch.num_rows for batch in self._pending) >= ROW_GROUP:
            self._flush()

    def close(self) -> None:
        """Write what waits and the footer."""
        if self._writer is not None:
            self._flush()
            self._writer.close()

    def _flush(self) -> None:
        table = self._pyarrow.Table.from_batches(self._pending, schema=self._schema)
        self._pending = []
        self._writer.write_table(table, row_group_size=max(len(table), 1))  # type: ignore[attr-defined]


def import_pyarrow(path: str) -> tuple[Any, Any]:
    """Return pyarrow and pyarrow.parquet, or say what is missing."""
    try:
        import pyarrow  # noqa: PLC0415 (not in the base install)
        import pyarrow.parquet  # noqa: PLC0415
    except ImportError:
        raise DataError(f"'{path}' is Parquet, which needs the train extra; install it or use CSV") from None
    return pyarrow, pyarrow.parquet
