"""Measured deviations of the tool, as a list of equations.

Each measured number is one linear functional of the six deviations (x, y, z, rotation vector) at one position: a
touch probe gives three of them a position, an R-test or a laser tracker with a rotation target up to six, a
tracker's range or a ballbar one along a line.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from model.exceptions import DataError
from model.machine import Machine
from model.positions import read_positions
from model.tables import Table
from model.transforms import Array

DISPLACEMENTS = ("dx_um", "dy_um", "dz_um")
ROTATIONS = ("da_urad", "db_urad", "dc_urad")
ALONG, LINE = "dl_um", ("nx", "ny", "nz")
UNCERTAINTIES = ("sigma_um", "sigma_urad")


@dataclass(frozen=True)
class Measurements:
    """m measured numbers at n positions.

    Attributes
    ----------
    q : shape (n, A) [mm, degree]
    tool_mm : tool tip in the tool frame at each position, shape (n, 3)
    position : shape (m,), at which of the positions each number was measured
    functional : shape (m, 6), the factors of the six deviations in it
    value : shape (m,) [µm, µrad]
    angular : shape (m,), whether it is an angle
    sigma : shape (m,), standard uncertainty of each number, up to a common factor
    absolute : whether that factor is known to be 1, because the file states uncertainties
    """

    q: Array
    tool_mm: Array
    position: NDArray[np.intp]
    functional: Array
    value: Array
    angular: NDArray[np.bool_]
    sigma: Array
    absolute: bool

    def __len__(self) -> int:
        return len(self.value)


def read_measurements(path: str | Path, machine: Machine) -> Measurements:
    """Read measurements from CSV or Parquet.

    One column per axis; any of dx_um, dy_um, dz_um, da_urad, db_urad, dc_urad and dl_um with its direction nx, ny,
    nz, in the workpiece frame, cells empty where nothing was measured; optionally tool_length_mm, and either
    sigma_um and sigma_urad or weight (in inverse proportion to the variance).

    Raises
    ------
    DataError
        where the file cannot be read, has no measured value, or a direction, weight or uncertainty is not one.
    """
    table, q = read_positions(path, machine)
    parts: list[tuple[NDArray[np.intp], Array, Array, bool]] = []
    for index, name in enumerate((*DISPLACEMENTS, *ROTATIONS)):
        rows, values = _measured(table, name)
        parts.append((rows, np.tile(np.eye(6)[index], (len(rows), 1)), values, name in ROTATIONS))
    rows, values = _measured(table, ALONG)
    parts.append((rows, _lines(table, rows), values, False))
    if not sum(len(rows) for rows, *_ in parts):
        wanted = ", ".join((*DISPLACEMENTS, *ROTATIONS, ALONG))
        raise DataError(f"'{path}' must have a measured value in one of the columns {wanted}, got none")
    return Measurements(
        q=q,
        tool_mm=_tool_tips(table, machine),
        position=np.concatenate([rows for rows, *_ in parts]),
        functional=np.concatenate([functional for _, functional, _, _ in parts]),
        value=np.concatenate([values for *_, values, _ in parts]),
        angular=np.concatenate([np.full(len(rows), angular) for rows, _, _, angular in parts]),
        sigma=np.concatenate([_sigma(table, rows, angular) for rows, _, _, angular in parts]),
        absolute=any(name in table.numbers for name in UNCERTAINTIES),
    )


def _measured(table: Table, name: str) -> tuple[NDArray[np.intp], Array]:
    """Return the rows in which a column has a value, and the values."""
    column = table.numbers.get(name, np.full(len(table), np.nan))
    rows = np.flatnonzero(~np.isnan(column))
    for row in rows[~np.isfinite(column[rows])]:
        raise DataError(f"column '{name}' of '{table.source}' must be finite, got {column[row]} in row {row + 1}")
    return rows, column[rows]


def _lines(table: Table, rows: NDArray[np.intp]) -> Array:
    """Return the functionals of displacements along lines, shape (len(rows), 6)."""
    if not len(rows):
        return np.zeros((0, 6))
    for name in LINE:
        if name not in table.numbers:
            raise DataError(f"'{table.source}' must have a column '{name}', the direction along which {ALONG} counts")
    line = np.stack([table.numbers[name][rows] for name in LINE], axis=1)
    length = np.linalg.norm(line, axis=1)
    for i in np.flatnonzero(~(np.isfinite(length) & (length > 0.0))):
        raise DataError(
            f"direction nx, ny, nz of '{table.source}' must be finite and not zero, "
            f"got {', '.join(f'{v:g}' for v in line[i])} in row {rows[i] + 1}"
        )
    return np.concatenate([line / length[:, None], np.zeros_like(line)], axis=1)


def _tool_tips(table: Table, machine: Machine) -> Array:
    """Return the tool tip of each row, the machine's own where no tool length is given."""
    default = np.tile(machine.tool.offset_mm, (len(table), 1))
    length = table.numbers.get("tool_length_mm")
    if length is None:
        return default
    for row in np.flatnonzero(np.isinf(length)):
        raise DataError(f"column 'tool_length_mm' of '{table.source}' must be finite, got inf in row {row + 1}")
    tip = length[:, None] * np.asarray(machine.tool.direction)
    return np.where(np.isnan(tip), default, tip)


def _sigma(table: Table, rows: NDArray[np.intp], angular: bool) -> Array:
    """Return the standard uncertainty of a column's values in those rows."""
    columns = [name for name in (*UNCERTAINTIES, "weight") if name in table.numbers]
    if "weight" in columns and len(columns) > 1:
        raise DataError(f"'{table.source}' must have either weight or {columns[0]}, got both")
    name = "weight" if "weight" in columns else UNCERTAINTIES[angular]
    if not columns or not len(rows):
        return np.ones(len(rows))
    if name not in columns:
        raise DataError(f"'{table.source}' must have a column '{name}' beside {columns[0]}")
    column = table.numbers[name][rows]
    for i in np.flatnonzero(~(np.isfinite(column) & (column > 0.0))):
        raise DataError(f"column '{name}' of '{table.source}' must be positive, got {column[i]:g} in row {rows[i] + 1}")
    return column if name != "weight" else 1.0 / np.sqrt(column)
