"""Arrow streams of positions: read batch by batch, checked, corrected, written. Runs in a thread of its own.

In goes one float64 column for each axis, in any order, and nothing else; out come the axes, the corrected coordinates,
the predicted deviation and whether a limit holds the correction back, with what a JSON reply says once as the schema's
metadata. No more than one batch is in memory at a time.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import nanoarrow as na
import numpy as np
from nanoarrow import ipc
from nanoarrow.c_array_stream import CArrayStream

from model.machine import Machine
from model.terms import UM
from model.transforms import Array
from model.validation import did_you_mean
from service.positions import check_range
from service.problems import unprocessable
from service.solver import Solved, Solver
from service.stream.envelope import Envelope

MAX_BATCH_POSITIONS = 2**18
"""Its coordinates and corrections take some 50 MB while it is worked on."""
PART = 2**16
"""Positions of a batch that is sent: 5 MB for three axes."""
ROOM_BYTES = 2**16
"""What a batch may have besides its coordinates: the description of its columns."""

FLOAT64 = "g"


@dataclass(frozen=True)
class Start:
    """What all corrections of one stream are computed from.

    Attributes
    ----------
    solver : of the error map that is served
    limited : whether the rate limit holds all corrections back
    said : what the reply says of all of them
    """

    solver: Solver
    limited: bool
    said: dict[str, Any]


class Piece(NamedTuple):
    """A piece of the answer, and how many positions' corrections are in it."""

    content: bytes
    positions: int


class Source(Protocol):
    """Where the stream is read from.

    Attributes
    ----------
    failure : why reading failed
    """

    failure: Exception | None

    def readinto(self, buffer: Any) -> int:
        """Fill the buffer, or as much of it as there is left; return how much."""
        ...

    def expect(self, most: int, what: str) -> None:
        """Read no more than so many bytes until called again; `what` they are, for the message."""
        ...


def corrected(source: Source, machine: Machine, begin: Callable[[], Start]) -> Iterator[Piece]:
    """Return the pieces of the answer; the first one comes once the first batch has been read and checked.

    Parameters
    ----------
    begin : hands out what corrections are computed from; called once

    Raises
    ------
    Problem
        422 where a batch is not what it must be, with its number.
    ComputeError
        where the compensation does not converge.
    """
    axes = machine.axis_names
    source = Envelope(source)
    most_bytes = MAX_BATCH_POSITIONS * 8 * len(axes) + ROOM_BYTES
    what = f"{MAX_BATCH_POSITIONS} positions"
    source.expect(most_bytes, what)
    try:
        stream = na.c_array_stream(ipc.InputStream.from_readable(source))
        columns = _columns(stream.get_schema(), machine)
    except (RuntimeError, UnicodeError) as problem:
        raise _unreadable(source, problem, "schema") from None
    writer: _Writer | None = None
    start: Start | None = None
    batches = iter(stream)
    first = number = 0
    while True:
        source.expect(most_bytes, what)
        try:
            batch = next(batches, None)
            if batch is not None:
                q = _coordinates(batch, columns, axes, number)
        except RuntimeError as problem:
            raise _unreadable(source, problem, f"batch {number}") from None
        if batch is not None:
            check_range(machine, q, first, "position")
        if start is None or writer is None:
            start = begin()
            writer = _Writer(axes, start.said)
            yield Piece(writer.taken(), 0)
        if batch is None:
            break
        for at in range(0, len(q), PART):
            part = q[at : at + PART]
            writer.add(part, start.solver.solve(part), limited=start.limited)
            yield Piece(writer.taken(), len(part))
        first += len(q)
        number += 1
    writer.end()
    yield Piece(writer.taken(), 0)


def _unreadable(source: Source, problem: Exception, where: str) -> Exception:
    """Return why the source failed, which the reader words anew, or else what the reader says of the bytes."""
    if source.failure is not None:
        return source.failure
    reason = " ".join(str(problem).split()).rpartition("): ")[2]
    return unprocessable(
        f"the body must be an Arrow stream of float64 columns, and its {where} cannot be read: {reason}"
    )


def _columns(schema: Any, machine: Machine) -> list[int]:
    """Return the place of each axis' column."""
    axes, known = machine.axis_names, "one float64 column for each of " + ", ".join(machine.axis_names)
    names = [child.name for child in schema.children]
    for child in schema.children:
        if child.name not in axes:
            raise unprocessable(f"unknown column '{child.name}' in the stream{did_you_mean(child.name, list(axes))}")
        if child.format != FLOAT64:
            raise unprocessable(f"column '{child.name}' must be float64, got the format '{child.format}'; cast it")
    for axis in axes:
        if names.count(axis) != 1:
            got = ", ".join(names) or "none"
            raise unprocessable(f"the stream must have {known}, got {got}")
    return [names.index(axis) for axis in axes]


def _coordinates(batch: Any, columns: Sequence[int], axes: Sequence[str], number: int) -> Array:
    """Return a batch's coordinates, shape (n, A)."""
    count = batch.length
    if count > MAX_BATCH_POSITIONS:
        raise unprocessable(
            f"a batch must have at most {MAX_BATCH_POSITIONS} positions, got {count}; send smaller ones"
        )
    q = np.empty((count, len(axes)))
    for column, (place, axis) in enumerate(zip(columns, axes, strict=True)):
        child = batch.child(place)
        if child.null_count:
            raise unprocessable(
                f"axis '{axis}' must be given at every position, got {child.null_count} nulls in batch {number}"
            )
        _, values = child.view().buffers
        start = batch.offset + child.offset
        found = np.frombuffer(values, dtype="<f8")[start : start + count]
        if len(found) != count:
            raise unprocessable(f"axis '{axis}' must have {count} coordinates in batch {number}, got {len(found)}")
        q[:, column] = found
    return q


class _Writer:
    """Writes batches as bytes to be taken away."""

    def __init__(self, axes: Sequence[str], said: dict[str, Any]) -> None:
        self._pieces: list[bytes] = []
        names = [*axes, *(f"{a}_corrected" for a in axes), "dx_um", "dy_um", "dz_um"]
        number, flag = na.float64(nullable=False), na.bool_(nullable=False)
        fields = dict.fromkeys(names, number) | {"limited": flag}
        metadata = {key: value if isinstance(value, str) else json.dumps(value) for key, value in said.items()}
        self._schema = na.c_schema(na.struct(fields, nullable=False)).modify(metadata=metadata)
        self._number, self._flag = na.c_schema(number), na.c_schema(flag)
        self._ipc = ipc.StreamWriter.from_writable(self)
        self._ipc.write_stream(CArrayStream.from_c_arrays([], self._schema))

    def write(self, data: Any) -> int:
        """Take what is written; called by the writer."""
        self._pieces.append(bytes(data))
        return len(self._pieces[-1])

    def add(self, q: Array, solved: Solved, *, limited: bool) -> None:
        """Write a batch of positions and their corrections."""
        table = np.concatenate([q, solved.corrected, solved.deviation_mm / UM], axis=1)
        self._ipc.write_array(self._batch(table, solved.clipped | limited))

    def end(self) -> None:
        """Write that the stream is complete."""
        self._ipc.close()

    def taken(self) -> bytes:
        """Return what has been written since the last time."""
        data = b"".join(self._pieces)
        self._pieces.clear()
        return data

    def _batch(self, table: Array, limited: Any) -> Any:
        count = len(table)
        columns = [
            na.c_array_from_buffers(self._number, count, [None, column], null_count=0)
            for column in np.ascontiguousarray(table.T, dtype="<f8")
        ]
        bits = np.packbits(limited, bitorder="little")
        columns.append(na.c_array_from_buffers(self._flag, count, [None, bits], null_count=0))
        return na.c_array_from_buffers(self._schema, count, [None], null_count=0, children=columns)
