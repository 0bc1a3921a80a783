"""Positions in files: one column per axis, in mm, and whatever other columns they carry."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from model.exceptions import DataError
from model.machine import Machine
from model.tables import Table, read_table
from model.transforms import Array


def read_positions(path: str | Path, machine: Machine, required: tuple[str, ...] = ()) -> tuple[Table, Array]:
    """Read positions and check them.

    Returns
    -------
    the table, and the coordinates of shape (n, A)

    Raises
    ------
    DataError
        where an axis' column is missing, or a coordinate is not finite or outside its axis' range.
    """
    table = read_table(path, required=(*required, *machine.axis_names))
    return table, check_positions(np.stack([table.numbers[a] for a in machine.axis_names], axis=1), machine, str(path))


def check_positions(q: Array, machine: Machine, where: str) -> Array:
    """Return q of shape (n, A), each coordinate finite and within its axis' range.

    Raises
    ------
    DataError
        naming the first row and axis that are not.
    """
    for column, name in enumerate(machine.axis_names):
        axis = machine.axes[name]
        wrong = ~((q[:, column] >= axis.low) & (q[:, column] <= axis.high))
        if wrong.any():
            row = int(np.argmax(wrong))
            raise DataError(
                f"axis '{name}' must lie within {axis.low:g} and {axis.high:g} {axis.unit}, got {q[row, column]:g} "
                f"in row {row + 1} of '{where}'"
            )
    return q
