"""Read a data set folder: machine, telemetry and measured error terms (DESIGN, section 5)."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from model.error_map import ErrorMap, Row
from model.error_tables import read_error_table
from model.exceptions import DataError
from model.machine import Machine, load_machine
from model.tables import Table, find_table, read_table
from model.telemetry import Run, read_telemetry
from model.transforms import Array
from model.validation import Strict, check

Datum = Literal["absolute", "run-start"]
Column = tuple[str, float | None]
"""A measured term, and its position on the axis [mm], None for location terms."""


class _DataSetFile(Strict):
    datum: Datum = "run-start"


@dataclass(frozen=True)
class MeasuredRun:
    """One run: what went in, and what the machine did.

    Attributes
    ----------
    telemetry : of the run
    time_s : of the measurements, shape (N,), rising [s]
    values : shape (N, J) [µm, µrad], NaN where not measured
    """

    telemetry: Run
    time_s: Array
    values: Array

    def between(self, sampled: Array) -> Array:
        """Return what is known at each telemetry sample, shape (T, ...), at the times of measurement (N, ...)."""
        left, weight = interpolation(self.telemetry.time_s, self.time_s)
        right = np.minimum(left + 1, len(sampled) - 1)
        weight = weight.reshape(-1, *([1] * (sampled.ndim - 1)))
        between: Array = sampled[left] * (1.0 - weight) + sampled[right] * weight
        return between


@dataclass(frozen=True)
class DataSet:
    """A data set.

    Attributes
    ----------
    sensors, channels : columns of the telemetry, in order
    columns : the J measured terms and positions
    geometry : cold errors, empty where none were measured
    fingerprint : SHA-256 over its files
    """

    path: Path
    machine: Machine
    datum: Datum
    sensors: tuple[str, ...]
    channels: tuple[str, ...]
    columns: tuple[Column, ...]
    runs: dict[str, MeasuredRun]
    geometry: list[Row]
    fingerprint: str

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the measured terms, in the machine's order."""
        measured = {term for term, _ in self.columns}
        return tuple(t.name for t in self.machine.terms if t.name in measured)


def load_dataset(path: str | Path) -> DataSet:
    """Read a data set.

    Raises
    ------
    InputError
        with one sentence that names the file and the place.
    """
    path = Path(path)
    if not path.is_dir():
        raise DataError(f"data set '{path}' must be a folder with machine.toml and telemetry; there is none")
    machine = load_machine(path)
    if not machine.sensors:
        raise DataError(f"data set '{path}': machine.toml must describe its sensors ([sensors.NAME]), got none")
    sensors = tuple(machine.sensors)
    telemetry = find_table(path, "telemetry")
    if telemetry is None:
        raise DataError(f"data set '{path}' must have telemetry.parquet or telemetry.csv, got neither")
    runs, channels = read_telemetry(telemetry, sensors)
    terms = find_table(path, "error_terms")
    if terms is None:
        raise DataError(
            f"data set '{path}' must have error_terms.parquet or error_terms.csv, got neither; "
            "training on tool_tip alone is not supported yet"
        )
    columns, measured = _read_terms(read_table(terms, ("run", "time_s", "term", "position", "value"), _TEXT), machine)
    for name in measured:
        if name not in runs:
            raise DataError(f"'{terms}': run '{name}' must be in the telemetry, got {', '.join(runs)}")
    datum = _datum(path)
    labelled: dict[str, MeasuredRun] = {}
    for name, (time_s, values) in measured.items():
        run = runs[name]
        outside = (time_s < run.time_s[0]) | (time_s > run.time_s[-1])
        if outside.any():
            raise DataError(
                f"'{terms}': measurements of run '{name}' must lie within its telemetry, "
                f"{run.time_s[0]:g} to {run.time_s[-1]:g} s, got {time_s[outside][0]:g}"
            )
        if len(time_s) < 2:
            raise DataError(f"'{terms}': run '{name}' must have at least two times of measurement, got one")
        labelled[name] = MeasuredRun(run, time_s, values)
    geometry = find_table(path, "geometry")
    rows = [] if geometry is None else _read_geometry(geometry, machine)
    return DataSet(path, machine, datum, sensors, tuple(channels), columns, labelled, rows, _fingerprint(path))


_TEXT = ("run", "term")
LARGEST_UM = 1e6
"""Larger errors, in µm or µrad, are no machine's (chosen): a metre is a wrong unit or a lost beam."""


def _read_geometry(file: Path, machine: Machine) -> list[Row]:
    rows = read_error_table(file)
    ErrorMap.from_rows(machine, rows, f"'{file}'")
    for number, (_, _, value) in enumerate(rows, start=1):
        _check_size(value, f"'{file}'", number)
    return rows


def _check_size(value: float, where: str, row: int) -> None:
    if abs(value) > LARGEST_UM:
        raise DataError(f"{where}: value must lie within ±{LARGEST_UM:g} µm or µrad, got {value:g} in row {row}")


def _fingerprint(path: Path) -> str:
    digest = hashlib.sha256()
    for name in ("machine", "dataset", "telemetry", "error_terms", "geometry"):
        for file in sorted(path.glob(f"{name}.*")):
            digest.update(file.name.encode())
            digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


def _datum(path: Path) -> Datum:
    file = path / "dataset.toml"
    if not file.exists():
        return "run-start"
    try:
        data = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as problem:
        raise DataError(f"'{file}' cannot be read: {problem.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise DataError(f"'{file}' is not TOML: {problem}") from None
    return check(_DataSetFile, data, f"'{file}'", DataError).datum


def _read_terms(table: Table, machine: Machine) -> tuple[tuple[Column, ...], dict[str, tuple[Array, Array]]]:
    """Return the measured columns, and per run the times (N,) and values (N, J)."""
    where = f"'{table.source}'"
    names = {written: _known(machine, written, where) for written in np.unique(table.text["term"]).tolist()}
    term = np.array([names[written] for written in table.text["term"].tolist()])
    position, time_s, value = (table.numbers[c] for c in ("position", "time_s", "value"))
    if not len(table):
        raise DataError(f"{where} must have at least one row, got none")
    for what, numbers in (("time_s", time_s), ("value", value)):
        if not np.isfinite(numbers).all():
            row = int(np.argmin(np.isfinite(numbers)))
            raise DataError(f"{where}: {what} must be a finite number, got {numbers[row]} in row {row + 1}")
    largest = int(np.argmax(np.abs(value)))
    _check_size(float(value[largest]), where, largest + 1)
    # Columns in the machine's order of terms, then by position; an empty position sorts first.
    places, place = np.unique(np.where(np.isnan(position), -np.inf, position), return_inverse=True)
    rank = np.array([machine.term_index[name] for name in term.tolist()])
    codes, column = np.unique(rank * len(places) + place.ravel(), return_inverse=True)
    columns = tuple(
        _column(machine, machine.terms[code // len(places)].name, float(places[code % len(places)]), where)
        for code in codes.tolist()
    )
    runs: dict[str, tuple[Array, Array]] = {}
    for name in dict.fromkeys(table.text["run"].tolist()):
        rows = np.flatnonzero(table.text["run"] == name)
        times, index = np.unique(time_s[rows], return_inverse=True)
        values = np.full((len(times), len(columns)), np.nan)
        cell = index.ravel() * len(columns) + column.ravel()[rows]
        if len(np.unique(cell)) < len(cell):
            first = rows[int(np.setdiff1d(np.arange(len(cell)), np.unique(cell, return_index=True)[1])[0])]
            at = "" if np.isnan(position[first]) else f"position {position[first]:g} and "
            raise DataError(
                f"{where}: {term[first]} at {at}time {time_s[first]:g} stands twice in "
                f"run '{name}', again in row {first + 1}; keep one"
            )
        values.ravel()[cell] = value[rows]
        runs[name] = (times, values)
    return columns, runs


def _known(machine: Machine, written: str, where: str) -> str:
    try:
        return machine.term(written).name
    except ValueError as problem:
        raise DataError(f"{where}: {problem}") from None


def _column(machine: Machine, name: str, position: float, where: str) -> Column:
    term = machine.term(name)
    if term.kind == "location":
        if position != -np.inf:
            raise DataError(f"{where}: {name} is a location term without position, got {position:g}; leave it empty")
        return name, None
    axis = machine.axes[term.axis]
    if not axis.low <= position <= axis.high:
        came = "an empty position" if position == -np.inf else f"{position:g}"
        raise DataError(
            f"{where}: {name} must have positions within axis {term.axis}, {axis.low:g} to {axis.high:g} mm, got {came}"
        )
    return name, position


def interpolation(knots: Array, at: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the left knot of each value in `at`, and its weight towards the right one."""
    left = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, max(len(knots) - 2, 0))
    if len(knots) == 1:
        return left, np.zeros(len(at))
    return left, np.clip((at - knots[left]) / (knots[left + 1] - knots[left]), 0.0, 1.0)


def runs_named(dataset: DataSet, names: Iterable[str], option: str) -> list[str]:
    """Return the run names after checking that the data set has them."""
    chosen = list(dict.fromkeys(n.strip() for n in names if n.strip()))
    for name in chosen:
        if name not in dataset.runs:
            raise DataError(f"{option} names run '{name}'; data set '{dataset.path}' has {', '.join(dataset.runs)}")
    return chosen
