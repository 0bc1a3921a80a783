"""The messages of an Arrow stream, looked at before their bodies are read: schemas and plain record batches alone.

A compressed batch is unpacked by the reader before anybody can ask how large it becomes: a kilobyte may become a
gigabyte. So compression is refused, where the message that announces it has been read and its body has not.

The form: Apache Arrow columnar format, "Encapsulated message format", and its `Message.fbs`.
"""

from __future__ import annotations

import struct
from typing import Any, Protocol

from flatbuffers import number_types
from flatbuffers.table import Table

from service.problems import unprocessable

CONTINUES = b"\xff\xff\xff\xff"
SCHEMA, RECORD_BATCH = 1, 3
MAX_METADATA_BYTES = 2**16
"""What describes a schema or a batch of nine columns takes 2 kB."""
_HEADER_TYPE, _HEADER, _BODY_LENGTH, _COMPRESSION = 6, 8, 10, 10  # places of fields in their tables' directories


class Readable(Protocol):
    """What bytes come from; see `arrow.Source`."""

    failure: Exception | None

    def readinto(self, buffer: Any) -> int:
        """Fill the buffer."""
        ...

    def expect(self, most: int, what: str) -> None:
        """Read no more than so many bytes until called again."""
        ...


class Envelope:
    """Passes a stream on to its reader, and stops it at a message that must not be read.

    Attributes
    ----------
    failure : why reading failed
    """

    def __init__(self, source: Readable) -> None:
        self._source = source
        self._head, self._wanted, self._body = b"", 8, 0
        self._described = False
        self.failure: Exception | None = None

    def expect(self, most: int, what: str) -> None:
        """Read no more than so many bytes until called again."""
        self._source.expect(most, what)

    def readinto(self, buffer: Any) -> int:
        """Fill the buffer, or as much of it as there is left; return how much.

        Raises
        ------
        Problem
            422 for a compressed batch, or a message that is none of a stream of batches.
        """
        try:
            count = self._source.readinto(buffer)
            self._follow(memoryview(buffer).cast("B")[:count])
        except Exception as problem:
            self.failure = problem
            raise
        return count

    def _follow(self, data: memoryview) -> None:
        while data:
            if self._body:
                skipped = min(self._body, len(data))
                self._body -= skipped
            else:
                skipped = min(self._wanted - len(self._head), len(data))
                self._head += data[:skipped]
                if len(self._head) == self._wanted:
                    self._step()
            data = data[skipped:]

    def _step(self) -> None:
        head, self._head = self._head, b""
        if self._described:
            self._wanted, self._described = 8, False
            try:
                self._body = _body_length(head)
            except (struct.error, IndexError, ValueError, TypeError, OverflowError):
                raise unprocessable("the body must be an Arrow stream, and a message in it cannot be read") from None
            return
        (length,) = struct.unpack("<i", head[4:])
        if head[:4] != CONTINUES or not 0 <= length <= MAX_METADATA_BYTES:
            raise unprocessable(
                "the body must be an Arrow stream, got something else; send "
                "application/vnd.apache.arrow.stream as Arrow 0.15 and newer write it"
            )
        if length:  # none is the end of the stream
            self._wanted, self._described = length, True


def _body_length(message: bytes) -> int:
    table = _table(message)
    kind = _number(table, _HEADER_TYPE, number_types.Uint8Flags)
    if kind not in {SCHEMA, RECORD_BATCH}:
        raise unprocessable(
            f"the stream must have a schema and record batches alone, got a message of kind {kind}; "
            "send plain float64 columns"
        )
    if kind == RECORD_BATCH:
        place = table.Offset(_HEADER)
        header = Table(table.Bytes, 0)
        table.Union(header, place)
        if header.Offset(_COMPRESSION):
            raise unprocessable(
                "record batches must not be compressed, got a compressed one; write without compression"
            )
    length = _number(table, _BODY_LENGTH, number_types.Int64Flags)
    if length < 0:
        raise ValueError
    return length


def _table(message: bytes) -> Table:
    (root,) = struct.unpack_from("<I", message)
    return Table(bytearray(message), root)


def _number(table: Table, field: int, kind: Any) -> int:
    place = table.Offset(field)
    return int(table.Get(kind, place + table.Pos)) if place else 0
