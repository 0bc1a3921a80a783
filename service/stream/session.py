"""What a stream answers to each message: JSON in and out, or arrays of numbers.

A binary request is the coordinates of n positions, float64, little-endian, position by position, in the order of the
axes that the settings' reply lists. A binary reply is a head of 16 bytes and then the corrected coordinates, likewise.
"""

from __future__ import annotations

import json
import struct
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError
from pydantic_core import to_json

from model.validation import sentence
from service.machine_state import MachineState
from service.positions import check_range
from service.problems import details, unprocessable
from service.routes.compensate import PLAIN, corrections
from service.schemas import MAX_POSITIONS_PER_REQUEST, Body, CompensateRequest, Name, Number, ToolRequest
from service.status import Status
from service.timestamps import Timestamp

HEAD = struct.Struct("<IBBHd")
"""Of a binary reply: positions, status (its place in `STATUSES`), flags, nothing yet, the machine's clock [s]."""
STATUSES = tuple(status.value for status in Status)
LIMITED, WARNED = 1, 2
"""Flags: a limit holds at least one correction back; there are warnings, which a JSON request tells."""
MAX_ID = 128
"""Longest id of a message, in characters."""


class StreamRequest(Body):
    """One JSON message: positions to correct, or, without any, settings for the messages that follow."""

    id: Annotated[str, Field(max_length=MAX_ID)] | int | None = Field(None, description="Comes back in the reply.")
    positions: Annotated[list[dict[Name, Number]], Field(min_length=1, max_length=MAX_POSITIONS_PER_REQUEST)] | None = (
        Field(None, description="As in `compensate`.")
    )
    tool: ToolRequest | None = Field(None, description="Default: the one set before, or the machine description's.")
    time: Timestamp | None = Field(None, description="Default: the service's clock, which counts unless in replay.")
    format: Literal["json", "binary"] | None = Field(None, description="Settings: what will be sent from here on.")


class Session:
    """One stream's machine and settings.

    Attributes
    ----------
    binary : whether binary messages were announced
    """

    def __init__(self, machine: MachineState, path: str) -> None:
        self._machine, self._path = machine, path
        self._tool: ToolRequest | None = None
        self.binary = False

    def answer(self, message: str | bytes) -> str | bytes:
        """Return the reply to one message; for a wrong one the problem's details, as JSON.

        Raises
        ------
        ThermotrueError
            as `MachineState.compensate`; `refusal` words it.
        """
        return self._answer_json(message) if isinstance(message, str) else self._answer_binary(message)

    def refusal(self, message: str | bytes, problem: Exception) -> str:
        """Return the details of the problem that a message ended with, and its id where it has a good one."""
        said = details(self._path, problem)
        if isinstance(message, str):
            said = {"id": _id_of(message)} | said
        return json.dumps(said, ensure_ascii=True)

    def _answer_json(self, message: str) -> str:
        try:
            given = StreamRequest.model_validate_json(message)
        except ValidationError as problem:
            raise unprocessable(_wrong(problem)) from None
        if given.positions is None:
            return self._set(given)
        if given.format is not None:
            raise unprocessable("key 'format' must come without 'positions', got both; send the settings first")
        request = CompensateRequest.model_construct(
            positions=given.positions, tool=given.tool or self._tool, time=given.time, temperatures=None, channels=None
        )
        return to_json({"id": given.id} | corrections(self._machine, request, PLAIN)).decode()

    def _set(self, given: StreamRequest) -> str:
        if given.format is None and given.tool is None:
            raise unprocessable("a message must have 'positions', or 'format' and 'tool' as settings, got none of them")
        if given.format is not None:
            self.binary = given.format == "binary"
        self._tool = given.tool or self._tool
        machine = self._machine.machine
        reply = {
            "id": given.id,
            "machine": machine.name,
            "model": self._machine.bundle.version,
            "format": "binary" if self.binary else "json",
            "axes": machine.axis_names,
            "tool": None if self._tool is None else {"length_mm": self._tool.length_mm},
            "statuses": STATUSES,
        }
        return to_json(reply).decode()

    def _answer_binary(self, message: bytes) -> bytes:
        machine = self._machine
        if not self.binary:
            raise unprocessable(
                'binary messages must be announced, got one before that; send {"format": "binary"} first'
            )
        axes = machine.machine.axis_names
        count, left = divmod(len(message), 8 * len(axes))
        if left or not 1 <= count <= MAX_POSITIONS_PER_REQUEST:
            raise unprocessable(
                f"a binary message must hold 1 to {MAX_POSITIONS_PER_REQUEST} positions of {8 * len(axes)} bytes, "
                f"float64 for each of {', '.join(axes)}, got {len(message)} bytes"
            )
        q = np.frombuffer(message, dtype="<f8").reshape(count, len(axes))
        check_range(machine.machine, q, 0, "position")
        tool_length_mm = None if self._tool is None else self._tool.length_mm
        found = machine.compensate(q, tool_length_mm, machine.now())
        outlook = found.outlook
        flags = LIMITED * bool(np.logical_or.reduce(found.limited)) + WARNED * bool(outlook.warnings)
        head = HEAD.pack(count, STATUSES.index(outlook.status), flags, 0, outlook.now_s)
        return head + found.corrected.astype("<f8", copy=False).tobytes()


def _wrong(problem: ValidationError) -> str:
    first = problem.errors(include_url=False)[0]
    if first["type"] == "json_invalid":
        return f"a text message must be JSON, got text that is not: {first['ctx']['error']}"
    if first["type"] == "model_type" or not first["loc"]:
        return "a text message must be a JSON object, got something else"
    return sentence(problem.errors(include_url=False), StreamRequest, "the message")


def _id_of(message: str) -> Any:
    try:
        given = json.loads(message)
    except (ValueError, RecursionError):
        return None
    found = given.get("id") if isinstance(given, dict) else None
    good = isinstance(found, str) and len(found) <= MAX_ID
    return found if good or (isinstance(found, int) and not isinstance(found, bool)) else None
