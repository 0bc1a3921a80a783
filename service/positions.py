"""Positions as arrays: checked as those in JSON are, in a few calls however many they are."""

from __future__ import annotations

import numpy as np

from model.machine import Machine
from model.transforms import Array
from service.problems import unprocessable


def check_range(machine: Machine, q: Array, first: int, what: str) -> None:
    """Refuse coordinates that are not numbers within the range of their axis.

    Parameters
    ----------
    q : shape (n, A) [mm]
    first : number of the first position, for the message
    what : what a position is called there, such as "position"

    Raises
    ------
    Problem
        422 that names the axis, the value and the position.
    """
    low, high = machine.axis_ends
    inside = (q >= low) & (q <= high)  # False where it is not a number
    if np.logical_and.reduce(inside, axis=None):
        return
    row = int(np.argmin(np.logical_and.reduce(inside, axis=1)))
    axis = machine.axes[machine.axis_names[int(np.argmin(inside[row]))]]
    value = q[row, machine.axis_names.index(axis.name)]
    raise unprocessable(
        f"axis '{axis.name}' must lie within {axis.low:g} and {axis.high:g} mm, got {value:.10g} "
        f"in {what} {first + row}"
    )
