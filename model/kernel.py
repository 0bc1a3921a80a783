"""The per-position path: machine code for blocks of positions, called with addresses of arrays.

`kernel_source.py` is what it is compiled from. Importing this loads what was kept of it or, once for a version and a
processor, compiles it: at installation or when a program starts, never when a position is asked for.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.kernel_cache import entry
from model.kernel_constants import (
    AFFINE,
    ERROR,
    ERROR_BACK,
    LANES,
    LINEAR,
    NOTHING,
    PLACE,
    ROTARY,
    ROW,
    SHIFT,
    SINGULAR,
    SLACK_RAD,
    SLIDE,
    TURN,
    rows,
)

__all__ = [
    "AFFINE",
    "ERROR",
    "ERROR_BACK",
    "LANES",
    "LINEAR",
    "NOTHING",
    "PLACE",
    "ROTARY",
    "ROW",
    "SHIFT",
    "SINGULAR",
    "SLACK_RAD",
    "SLIDE",
    "TURN",
    "address",
    "rows",
    "solve",
]

Array = NDArray[Any]

_run, _memory = entry()


def address(array: Array, dtype: type[np.generic], *shape: int) -> int:
    """Return where an array begins, for compiled code, which looks nothing up.

    Raises
    ------
    TypeError
        where it is not what the code takes it for.
    """
    if array.dtype != dtype or array.shape != shape or not array.flags.c_contiguous or not array.flags.aligned:
        raise TypeError(f"the compiled path needs {dtype.__name__} of shape {shape}, got {array.dtype} {array.shape}")
    if array.flags.writeable and array.size:  # in a fifth of the time
        return ctypes.addressof(ctypes.c_char.from_buffer(array))  # type: ignore[arg-type]
    return int(array.__array_interface__["data"][0])


def solve(
    positions: Array, start: int, stop: int, before: tuple[int, ...], linear: int, rotary: int, results: Array
) -> None:
    """Compensate positions[start:stop], shape (n, A); see `kernel_source.solve`.

    Parameters
    ----------
    before : the arguments of `kernel_source.entry` between `stop` and `corrected`; their arrays must stay
    linear, rotary : how many axes may move
    results : shape (n (A + 5),): corrected (n, A), residual (n,), tilt (n,), deviation (n, 3), one after the other
    """
    n, axes = positions.shape
    if not 0 <= start <= stop <= n:
        raise IndexError(f"positions {start} to {stop} must lie within {n}")
    # Room to work in, of this call alone, since several threads may be here: numbers of 8 bytes, one after the other.
    work = (rows(linear, rotary) + 2 * axes) * LANES
    active = linear + 2 * rotary + 1
    room = np.zeros(work + active + 2 * 3 * 3 + LANES)
    here = address(room, np.float64, len(room))
    there = address(results, np.float64, n * (axes + 5))
    _run(
        address(positions, np.float64, n, axes),
        axes,
        start,
        stop,
        *before,
        there,
        there + 8 * n * axes,
        there + 8 * n * (axes + 1),
        there + 8 * n * (axes + 2),
        here,
        here + 8 * work,
        here + 8 * (work + active),
        here + 8 * (work + active + 2 * 3 * 3),
    )
