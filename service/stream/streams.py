"""The streams that are open: how many there may be, and how they end when the service stops."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator
from contextlib import contextmanager

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from service.stream.places import Places

log = logging.getLogger(__name__)

GOING_AWAY, SLOW, BROKEN, REVOKED = 1001, 1008, 1011, 4401
"""Codes that a stream ends with: the service stops; replies are not fetched; an error that nobody expected; the caller
would not be let in any more."""
MAX_STREAMS = 256
"""Each holds a connection and, at worst, a message and a reply of 1 MB in memory; a hall has fewer machines."""
STOP_S = 1.0
"""How long to wait for all streams to be told that the service stops [s]."""


class Streams:
    """All open streams.

    Parameters
    ----------
    most : how many may be open at a time
    """

    def __init__(self, most: int = MAX_STREAMS) -> None:
        self._places = Places(most, "streams")
        self._open: set[WebSocket] = set()

    @contextmanager
    def place(self, websocket: WebSocket) -> Iterator[None]:
        """Count a stream as open.

        Raises
        ------
        Problem
            503 where there are too many.
        """
        with self._places.place():
            self._open.add(websocket)
            try:
                yield
            finally:
                self._open.discard(websocket)

    async def close(self) -> None:
        """Tell all that the service stops."""
        ending = [asyncio.create_task(end(w, GOING_AWAY, "the service stops; connect again")) for w in self._open]
        if ending:
            await asyncio.wait(ending, timeout=STOP_S)


async def end(websocket: WebSocket, code: int, reason: str) -> None:
    """Close a stream that may have ended already."""
    if websocket.application_state is not WebSocketState.CONNECTED:
        return
    try:
        await websocket.close(code, reason)
    except (RuntimeError, WebSocketDisconnect, OSError):
        log.debug("stream had ended", extra={"code": code})
