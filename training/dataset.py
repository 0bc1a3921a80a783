"""Read a data set folder: machine, telemetry, and measured error terms or tool-tip deviations (DESIGN, section 5)."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass, replace
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
from training.touches import Places, Touches, no_touches, read_touches, without_cold
from training.volume import moving_terms

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
    values : shape (N, J + 3m) [µm, µrad], NaN where not measured: the terms, and behind them the tip's deviations in x,
        y and z at each of the m places
    places : shape (N, m, A), positions of the axes at the m places [mm, degree], NaN where the tip was not measured;
        None where it never was
    """

    telemetry: Run
    time_s: Array
    values: Array
    places: Array | None = None

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
    places : m, at how many positions one time can have the tip's deviation; 0 where it was not measured
    unmeasured : runs of the telemetry of which nothing was measured; they are not in `runs`
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
    places: int = 0
    unmeasured: tuple[str, ...] = ()

    @property
    def measured_terms(self) -> tuple[str, ...]:
        """Names of the terms that were measured themselves, in the machine's order."""
        measured = {term for term, _ in self.columns}
        return tuple(t.name for t in self.machine.terms if t.name in measured)

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms that can be learned: the measured ones, and of a measured tip all that move it."""
        known = {*self.measured_terms, *(moving_terms(self.machine) if self.places else ())}
        return tuple(t.name for t in self.machine.terms if t.name in known)


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
    labels, tips = find_table(path, "error_terms"), find_table(path, "tool_tip")
    if labels is None and tips is None:
        raise DataError(
            f"data set '{path}' must have error_terms.parquet or error_terms.csv, or tool_tip.parquet or tool_tip.csv, "
            "got none of them"
        )
    columns, measured = (
        ((), {})
        if labels is None
        else _read_terms(read_table(labels, ("run", "time_s", "term", "position", "value"), _TEXT), machine)
    )
    touched = {} if tips is None else read_touches(tips, machine, LARGEST_UM)
    datum = _datum(path)
    file = find_table(path, "geometry")
    geometry = [] if file is None else _read_geometry(file, machine)
    if geometry and datum == "absolute":  # since the run's start, the cold machine's errors have cancelled
        cold = ErrorMap.from_rows(machine, geometry)
        touched = {name: without_cold(touches, machine, cold) for name, touches in touched.items()}
    places = Places.of(touched.values())
    labelled: dict[str, MeasuredRun] = {}
    for name in dict.fromkeys([*measured, *touched]):
        sources = [(labels, measured[name][0])] if name in measured else []
        sources += [(tips, touched[name].time_s)] if name in touched else []
        for source, times in sources:
            _check_times(f"'{source}'", name, times, runs)
        labelled[name] = _measured_run(
            runs[name],
            measured.get(name, (np.zeros(0), np.zeros((0, len(columns))))),
            touched.get(name, no_touches(machine)),
            places,
        )
        if len(labelled[name].time_s) < 2:
            raise DataError(f"'{sources[0][0]}': run '{name}' must have at least two times of measurement, got one")
    found = _fingerprint(path)
    rest = tuple(name for name in runs if name not in labelled)
    names = (sensors, tuple(channels), columns)
    dataset = DataSet(path, machine, datum, *names, labelled, geometry, found, places.count, rest)
    return _without_idle_touches(dataset)


def _without_idle_touches(dataset: DataSet) -> DataSet:
    """Return the data set without tip deviations, where each stands beside all terms: they say nothing new."""
    count = len(dataset.columns)
    for run in dataset.runs.values():
        touched = np.isfinite(run.values[:, count:]).any(axis=1)
        if not np.isfinite(run.values[touched, :count]).all():
            return dataset
    if not set(moving_terms(dataset.machine)) <= set(dataset.measured_terms):
        return dataset
    runs = {name: replace(run, values=run.values[:, :count], places=None) for name, run in dataset.runs.items()}
    return replace(dataset, runs=runs, places=0)


def _check_times(where: str, name: str, time_s: Array, runs: dict[str, Run]) -> None:
    if name not in runs:
        raise DataError(f"{where}: run '{name}' must be in the telemetry, got {', '.join(runs)}")
    run = runs[name]
    if len(run.time_s) < 2:
        raise DataError(f"{where}: run '{name}' must have at least two rows of telemetry, got one; take it out")
    outside = (time_s < run.time_s[0]) | (time_s > run.time_s[-1])
    if outside.any():
        raise DataError(
            f"{where}: measurements of run '{name}' must lie within its telemetry, "
            f"{run.time_s[0]:g} to {run.time_s[-1]:g} s, got {time_s[outside][0]:g}"
        )


def _measured_run(telemetry: Run, terms: tuple[Array, Array], touches: Touches, places: Places) -> MeasuredRun:
    """Return a run with everything that was measured, at the times of either kind."""
    times, measured = terms
    time_s = np.union1d(times, touches.time_s)
    q, deviation = places.arrange(touches, time_s)
    values = np.concatenate([np.full((len(time_s), measured.shape[1]), np.nan), deviation.reshape(len(time_s), -1)], 1)
    values[np.searchsorted(time_s, times), : measured.shape[1]] = measured
    return MeasuredRun(telemetry, time_s, values, q if places.count else None)


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
    for name in ("machine", "dataset", "telemetry", "error_terms", "tool_tip", "geometry"):
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
