"""`compensate` for millions of positions: an Arrow stream in, an Arrow stream out."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator

from fastapi import Request
from pydantic import ValidationError
from starlette.types import Receive, Scope, Send

from model.validation import sentence
from service.content_type import ARROW
from service.machine_state import MachineState
from service.problems import unprocessable
from service.routes.dependencies import header, machine_named
from service.schemas import CompensateQuery
from service.stream.arrow import Piece, Start, corrected
from service.stream.body import Body, Left
from service.stream.places import Places

log = logging.getLogger(__name__)

SEND_S = 30.0
"""How long a piece of the answer may wait for the client to fetch the one before it [s]."""


async def correct_stream(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer a request whose body is an Arrow stream.

    All is computed from the error map that is served when the first batch has come. What is wrong up to there gets a
    problem; what is wrong later ends the connection without the end of the stream, so that nobody takes the answer for
    whole.
    """
    request = Request(scope)
    machine = machine_named(request.path_params["name"], request)
    query = _query(request)
    places: Places = request.app.state.bulk
    loop = asyncio.get_running_loop()
    body = Body(receive, loop)

    async def start() -> Start:
        return _start(machine, query.tool_length_mm)

    def begin() -> Start:
        return asyncio.run_coroutine_threadsafe(start(), loop).result()

    with places.place():
        pieces = corrected(body, machine.machine, begin)
        try:
            piece = await _next(pieces)
            await send({"type": "http.response.start", "status": 200, "headers": [(b"content-type", ARROW)]})
            await _pass_on(machine, piece, pieces, send)
        except Left:
            log.info("bulk stream ended by the client", extra={"machine": machine.machine.name})
        finally:
            body.leave()


async def _pass_on(machine: MachineState, piece: Piece | None, pieces: Iterator[Piece], send: Send) -> None:
    """Send piece after piece; where one cannot be made, the answer stays without its end, and the connection goes."""
    while piece is not None:
        try:
            async with asyncio.timeout(SEND_S):
                await send({"type": "http.response.body", "body": piece.content, "more_body": True})
            machine.counts.positions += piece.positions
            piece = await _next(pieces)
        except Exception as problem:
            why = "the client did not fetch it" if isinstance(problem, TimeoutError) else str(problem)
            log.warning("bulk stream broken off", extra={"machine": machine.machine.name, "reason": why})
            return
    await send({"type": "http.response.body", "body": b""})


async def _next(pieces: Iterator[Piece]) -> Piece | None:
    """Return the next piece, made in a thread; None after the last."""
    return await asyncio.to_thread(next, pieces, None)


def _start(machine: MachineState, tool_length_mm: float | None) -> Start:
    outlook, served, solver = machine.hand_out_solver(tool_length_mm, machine.now())
    said = header(machine, outlook.now_s, outlook.status)
    said |= {"reliability": outlook.target.weight, "warnings": outlook.warnings}
    return Start(solver, not served.arrived, said)


def _query(request: Request) -> CompensateQuery:
    try:
        query = CompensateQuery.model_validate(dict(request.query_params))
    except ValidationError as problem:
        raise unprocessable(sentence(problem.errors(include_url=False), CompensateQuery, "the query")) from None
    if query.explain:
        raise unprocessable("key 'explain' in the query goes with JSON; explain a few of the positions there")
    return query
