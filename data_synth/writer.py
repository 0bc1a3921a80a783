"""A data set on disk, one run at a time: what is in memory does not grow with the number of runs."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
import pyarrow as pa
from pyarrow import csv, parquet

from data_synth.faults import Fault
from data_synth.geometric import Row
from data_synth.probe import Touches
from data_synth.run import Run
from model.error_tables import write_error_table
from model.machine import Machine
from model.parquet_stream import ROW_GROUP

Format = Literal["parquet", "csv"]

REPEATED = ("run", "time_s", "term", "position", "sensor", "kind", "other")
"""Columns of few values, which Parquet keeps as a list of values and their numbers; others are faster as they are."""


class DataSetWriter:
    """Writes telemetry, error terms and what else a run has, run after run into a folder, as parquet or csv.

    The same runs give the same bytes.
    """

    def __init__(self, folder: Path, machine: Machine, geometry: tuple[Row, ...], form: Format) -> None:
        self._folder, self._machine, self._form = folder, machine, form
        self._open: dict[str, _Csv | _Parquet] = {}
        (folder / "machine.toml").write_text(machine.source, encoding="utf-8", newline="\n")
        (folder / "dataset.toml").write_text(
            '# Deviations are relative to the machine at its uniform reference temperature.\ndatum = "absolute"\n',
            encoding="utf-8",
            newline="\n",
        )
        write_error_table(folder / "geometry.csv", ((row.term, row.position, row.value) for row in geometry))

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish the files."""
        self.close()

    def close(self) -> None:
        """Finish the files."""
        for file in self._open.values():
            file.close()
        self._open.clear()

    def write(self, run: Run, touches: Touches | None = None) -> None:
        """Append one run, and what a probe measured in it."""
        telemetry = {"run": _repeated(run.name, len(run.time_s)), "time_s": pa.array(run.time_s)}
        telemetry |= {name: pa.array(values, from_pandas=True) for name, values in run.sensors.items()}
        telemetry |= {name: pa.array(values) for name, values in run.channels.items()}
        self._append("telemetry", telemetry)
        self._append("error_terms", self._error_terms(run))
        if touches is not None:
            self._append("tool_tip", self._tool_tip(run.name, touches))
        if run.faults is not None:
            self._append("faults", _faults(run.faults))

    def _error_terms(self, run: Run) -> dict[str, Any]:
        heads, values = run.terms.columns(self._machine)
        times = len(run.terms_time_s)
        terms = list(dict.fromkeys(term for term, _ in heads))
        term = np.tile(np.array([terms.index(name) for name, _ in heads], dtype=np.int32), times)
        position = np.tile(np.array([np.nan if p is None else p for _, p in heads]), times)
        return {
            "run": _repeated(run.name, values.size),
            "time_s": pa.array(np.repeat(run.terms_time_s, len(heads))),
            "term": pa.DictionaryArray.from_arrays(term, pa.array(terms)),
            "position": pa.array(position, mask=np.isnan(position)),
            "value": pa.array(np.round(values, 4).ravel() + 0.0),  # a tenth of a nanometre; no minus zero
        }

    def _tool_tip(self, run: str, touches: Touches) -> dict[str, Any]:
        columns = {"run": _repeated(run, len(touches.time_s)), "time_s": pa.array(touches.time_s)}
        columns |= {axis: pa.array(touches.q[:, k]) for k, axis in enumerate(self._machine.axis_names)}
        return columns | {f"d{axis}_um": pa.array(touches.deviation_um[:, k]) for k, axis in enumerate("xyz")}

    def _append(self, name: str, columns: dict[str, Any]) -> None:
        table = pa.table(columns)
        if name not in self._open:
            self._open[name] = (_Csv if self._form == "csv" else _Parquet)(self._folder / f"{name}.{self._form}", table)
        self._open[name].write(table)


class _Csv:
    """A CSV file."""

    def __init__(self, path: Path, first: Any) -> None:
        # It knows no dictionaries.
        plain = [pa.field(f.name, pa.string() if pa.types.is_dictionary(f.type) else f.type) for f in first.schema]
        self._schema = pa.schema(plain)
        self._file = csv.CSVWriter(path, self._schema)

    def write(self, table: Any) -> None:
        self._file.write_table(table.cast(self._schema))

    def close(self) -> None:
        self._file.close()


class _Parquet:
    """A Parquet file of large row groups, whose rows wait in memory until there are enough for one."""

    def __init__(self, path: Path, first: Any) -> None:
        self._file = parquet.ParquetWriter(
            path,
            first.schema,
            compression="zstd",
            use_dictionary=[column for column in first.column_names if column in REPEATED],
            store_schema=False,  # so that text is read back as text
        )
        self._pending: list[Any] = []

    def write(self, table: Any) -> None:
        self._pending.append(table)
        if sum(map(len, self._pending)) >= ROW_GROUP:
            self._flush()

    def close(self) -> None:
        if self._pending:
            self._flush()
        self._file.close()

    def _flush(self) -> None:
        table = pa.concat_tables(self._pending).unify_dictionaries()
        self._pending = []
        self._file.write_table(table, row_group_size=max(len(table), 1))


def _repeated(text: str, n: int) -> Any:
    return pa.DictionaryArray.from_arrays(np.zeros(n, dtype=np.int32), pa.array([text]))


def _faults(faults: tuple[Fault, ...]) -> dict[str, Any]:
    """Return the table of a run's faults, which has its columns even where none came."""
    kinds = {name: pa.string() for name in ("run", "sensor", "kind")}
    kinds |= {"start_s": pa.float64(), "end_s": pa.float64(), "magnitude_K": pa.float64(), "other": pa.string()}
    return {name: pa.array([getattr(fault, name) for fault in faults], kind) for name, kind in kinds.items()}
