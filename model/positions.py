"""Positions in files: one column per axis, in mm, and whatever other columns they carry."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from model.exceptions import DataError
from model.machine import Machine
from model.streams import Chunk
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


def coordinates(chunk: Chunk, machine: Machine) -> Array:
    """Return the coordinates in a chunk, shape (n, A), checked.

    Raises
    ------
    DataError
        where a coordinate is not a number or outside its axis' range.
    """
    q = np.stack([chunk.numbers(a) for a in machine.axis_names], axis=1)
    return check_positions(q, machine, chunk.source, chunk.first)


def check_positions(q: Array, machine: Machine, where: str, first: int = 0) -> Array:
    """Return q of shape (n, A), each coordinate finite and within its axis' range; `first` rows come before it.

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
                f"in row {first + row + 1} of '{where}'"
            )
    return q
