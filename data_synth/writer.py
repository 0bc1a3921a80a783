"""A data set on disk, one run at a time: what is in memory does not grow with the number of runs."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
import pyarrow as pa
from pyarrow import csv, parquet

from data_synth.geometric import Row
from data_synth.run import Run
from model.error_tables import write_error_table
from model.machine import Machine

Format = Literal["parquet", "csv"]


class DataSetWriter:
    """Writes telemetry and error terms of run after run into a folder, as parquet or csv.

    The same runs give the same bytes.
    """

    def __init__(self, folder: Path, machine: Machine, geometry: tuple[Row, ...], form: Format) -> None:
        self._folder, self._machine, self._form = folder, machine, form
        self._open: dict[str, Any] = {}
        self.rows = 0
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
        for file in self._open.values():
            file.close()

    def write(self, run: Run) -> None:
        """Append one run."""
        telemetry = {"run": _repeated(run.name, len(run.time_s)), "time_s": pa.array(run.time_s)}
        telemetry |= {name: pa.array(values) for name, values in run.sensors.items()}
        telemetry |= {name: pa.array(values) for name, values in run.channels.items()}
        self._append("telemetry", pa.table(telemetry))
        self._append("error_terms", self._error_terms(run))

    def _error_terms(self, run: Run) -> Any:
        heads, values = run.terms.columns(self._machine)
        times = len(run.terms_time_s)
        terms = list(dict.fromkeys(term for term, _ in heads))
        term = pa.DictionaryArray.from_arrays(
            np.tile(np.array([terms.index(name) for name, _ in heads], dtype=np.int32), times), pa.array(terms)
        )
        position = np.tile(np.array([np.nan if p is None else p for _, p in heads]), times)
        self.rows += values.size
        return pa.table(
            {
                "run": _repeated(run.name, values.size),
                "time_s": pa.array(np.repeat(run.terms_time_s, len(heads))),
                "term": term.cast(pa.string()),
                "position": pa.array(position, mask=np.isnan(position)),
                "value": pa.array(np.round(values, 4).ravel() + 0.0),  # a tenth of a nanometre; no minus zero
            }
        )

    def _append(self, name: str, table: Any) -> None:
        if name not in self._open:
            path = self._folder / f"{name}.{self._form}"
            self._open[name] = (
                csv.CSVWriter(path, table.schema)
                if self._form == "csv"
                else parquet.ParquetWriter(path, table.schema, compression="zstd")
            )
        self._open[name].write_table(table)


def _repeated(text: str, n: int) -> Any:
    return pa.DictionaryArray.from_arrays(np.zeros(n, dtype=np.int32), pa.array([text])).cast(pa.string())
