"""Telemetry files: `run`, `time_s`, one column per sensor [°C]; other numeric columns are extra channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from model.exceptions import DataError
from model.tables import Table, read_table
from model.transforms import Array

LARGEST_DEGC, LARGEST_CHANNEL = 1000.0, 1e9
"""Larger temperatures and channels are no machine's (chosen): a fault code, or a wrong unit."""


@dataclass(frozen=True)
class Run:
    """Telemetry of one run, from power-on.

    Attributes
    ----------
    time_s : shape (T,), rising [s]
    temperatures : shape (T, S) [°C], NaN where a sensor has no reading
    channels : shape (T, C)
    """

    name: str
    time_s: Array
    temperatures: Array
    channels: Array


def channel_names(table: Table, sensors: Sequence[str]) -> list[str]:
    """Return the numeric columns that are neither time nor a sensor."""
    return [name for name in table.numbers if name != "time_s" and name not in sensors]


def read_telemetry(
    path: str | Path, sensors: Sequence[str], channels: Sequence[str] | None = None
) -> tuple[dict[str, Run], list[str]]:
    """Read the runs of a telemetry file, in the file's order.

    Parameters
    ----------
    sensors : columns that must be there; empty cells are readings that are missing
    channels : further columns that must be there, by default all other numeric columns

    Returns
    -------
    runs by name, and the names of the channels

    Raises
    ------
    DataError
        where a column is missing, a temperature is infinite, a channel is not finite, either is beyond any
        machine's, a sensor has no reading in a run, or time does not rise within a run.
    """
    table = read_table(path, required=("run", "time_s"))
    for sensor in sensors:
        if sensor not in table.numbers:
            raise DataError(
                f"'{path}' must have a column for each sensor of the machine, got none for '{sensor}'; "
                "add it (empty cells where there is no reading) or take the sensor out of machine.toml"
            )
    names = channel_names(table, sensors) if channels is None else list(channels)
    for name in names:
        if name not in table.numbers:
            raise DataError(f"'{path}' must have the channel '{name}' that the network was trained with, got none")
    time_s = table.numbers["time_s"]
    temperatures = _columns(table, sensors)
    extra = _columns(table, names)
    _check_finite(path, "time_s", time_s[:, None], ["time_s"])
    _check_finite(path, "temperature", np.where(np.isnan(temperatures), 0.0, temperatures), sensors)
    _check_finite(path, "channel", extra, names)
    _check_size(path, "temperature", temperatures, sensors, LARGEST_DEGC, " °C")
    _check_size(path, "channel", extra, names, LARGEST_CHANNEL, "")
    runs: dict[str, Run] = {}
    run_column = table.text["run"]
    for name in dict.fromkeys(run_column.tolist()):
        rows = np.flatnonzero(run_column == name)
        steps = np.diff(time_s[rows])
        if (steps <= 0).any():
            at = int(np.argmax(steps <= 0))
            raise DataError(
                f"'{path}': time_s must rise within run '{name}', got {time_s[rows[at + 1]]:g} after "
                f"{time_s[rows[at]]:g} in row {rows[at + 1] + 1}"
            )
        for column, sensor in enumerate(sensors):
            if np.isnan(temperatures[rows, column]).all():
                raise DataError(f"'{path}': sensor '{sensor}' must have a reading in run '{name}', got none")
        runs[name] = Run(name, time_s[rows], temperatures[rows], extra[rows])
    if not runs:
        raise DataError(f"'{path}' must have at least one row, got none")
    return runs, names


def _columns(table: Table, names: Sequence[str]) -> Array:
    if not names:
        return np.empty((len(table), 0))
    return np.stack([table.numbers[name] for name in names], axis=1)


def _check_finite(path: str | Path, what: str, values: Array, names: Sequence[str]) -> None:
    wrong = ~np.isfinite(values)
    if wrong.any():
        row, column = (int(i) for i in np.argwhere(wrong)[0])
        raise DataError(
            f"'{path}': {what} '{names[column]}' must be a finite number, got {values[row, column]} in row {row + 1}"
        )


def _check_size(path: str | Path, what: str, values: Array, names: Sequence[str], largest: float, unit: str) -> None:
    wrong = np.abs(values) > largest
    if wrong.any():
        row, column = (int(i) for i in np.argwhere(wrong)[0])
        raise DataError(
            f"'{path}': {what} '{names[column]}' must lie within ±{largest:g}{unit}, got {values[row, column]:g} in "
            f"row {row + 1}"
        )
