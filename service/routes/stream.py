"""`/v1/machines/{name}/stream`: a WebSocket for control loops, positions in and corrections out."""

from __future__ import annotations

import asyncio
import logging
import time
from contextlib import suppress

from fastapi import APIRouter, WebSocket, WebSocketDisconnect

from model.exceptions import ThermotrueError
from service.access.roles import Role, caller_of, check_role
from service.overload import Turns
from service.routes.dependencies import machine_named
from service.stream.session import Session
from service.stream.streams import BROKEN, REVOKED, SLOW, Streams, end

log = logging.getLogger(__name__)
router = APIRouter(prefix="/v1")

SLOW_READER_S = 10.0
"""How long a reply may wait for the client to fetch the ones before it [s]: thousands of control cycles."""


@router.websocket("/machines/{name}/stream")
async def stream(websocket: WebSocket, name: str) -> None:
    """Correct positions as they come; one message is answered before the next is read."""
    check_role(websocket, Role.GATEWAY)
    session = Session(machine_named(name, websocket), websocket.url.path)
    streams: Streams = websocket.app.state.streams
    with streams.place(websocket), suppress(WebSocketDisconnect):
        await websocket.accept()
        await _converse(websocket, session, websocket.app.state.turns)


async def _converse(websocket: WebSocket, session: Session, turns: Turns) -> None:
    while True:
        came = await websocket.receive()
        if came["type"] == "websocket.disconnect":
            return
        if not websocket.app.state.key_ring.lets_in(caller_of(websocket)):
            await end(websocket, REVOKED, "the key was revoked")
            return
        text, data = came.get("text"), came.get("bytes")
        message: str | bytes = text if text is not None else data or b""
        await turns.take()  # a stream asks again as soon as it has its answer, and others wait, too
        began_s = time.perf_counter()
        broken = False
        try:
            reply = session.answer(message)
        except ThermotrueError as problem:
            reply = session.refusal(message, problem)
        except Exception as problem:
            log.exception("stream failed")
            reply, broken = session.refusal(message, problem), True
        turns.took(time.perf_counter() - began_s)
        if not await _send(websocket, reply):
            return
        if broken:
            await end(websocket, BROKEN, "the service failed on a message; its log has the traceback")
            return


async def _send(websocket: WebSocket, reply: str | bytes) -> bool:
    """Send a reply; False where the client does not fetch what it was sent."""
    try:
        async with asyncio.timeout(SLOW_READER_S):
            if isinstance(reply, str):
                await websocket.send({"type": "websocket.send", "text": reply})
            else:
                await websocket.send({"type": "websocket.send", "bytes": reply})
    except TimeoutError:
        await end(websocket, SLOW, f"replies must be fetched within {SLOW_READER_S:g} s")
        return False
    return True
