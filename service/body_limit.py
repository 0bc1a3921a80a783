"""Refuse request bodies that are too large, before they fill the memory, and wait no longer than that for the rest."""

from __future__ import annotations

import asyncio
from http import HTTPStatus

from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.content_type import ARROW, content_type

MAX_BODY_BYTES = 8 * 1024 * 1024
"""The largest telemetry request of a machine with 60 sensors has 6 MB; parsed, a body takes ten times its size."""
BODY_S = 30.0
"""How long a whole body may take to come [s]: the largest over 3 Mbit/s. A request counts as in work meanwhile, so
connections that hang in the middle of one would in the end leave no place for others."""


class BodyLimit:
    """ASGI middleware that ends a request whose body is longer than `MAX_BODY_BYTES`, or not there within `BODY_S`.

    It raises where the body is read, so the answer is made where all others are.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, counting the bytes that are read of its body."""
        if scope["type"] != "http" or _bounds_itself(scope):
            await self._app(scope, receive, send)
            return
        declared = dict(scope["headers"]).get(b"content-length", b"0")
        read = int(declared) if declared.isdigit() and int(declared) > MAX_BODY_BYTES else 0
        until_s: float | None = None
        whole = late = False

        async def counted() -> Message:
            nonlocal read, until_s, whole, late
            if whole:  # what comes after the body tells that the client has left
                return await receive()
            if read <= MAX_BODY_BYTES and not late:
                until_s = asyncio.get_running_loop().time() + BODY_S if until_s is None else until_s
                try:
                    async with asyncio.timeout_at(until_s):
                        message = await receive()
                except TimeoutError:
                    late = True
                else:
                    read += len(message.get("body", b""))
                    whole = not message.get("more_body", False)
            if late:
                detail = (
                    f"the body must be there within {BODY_S:g} s, and was not; send it again, in parts if it is long"
                )
                raise HTTPException(HTTPStatus.REQUEST_TIMEOUT, detail, {"Connection": "close"})
            if read > MAX_BODY_BYTES:
                whole = False
                detail = f"the body must be at most {MAX_BODY_BYTES} bytes, got more; send it in parts"
                raise HTTPException(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, detail)
            return message

        await self._app(scope, counted, send)


def _bounds_itself(scope: Scope) -> bool:
    """Return whether the body is read batch by batch, however long it is."""
    return str(scope["path"]).endswith("/compensate") and content_type(scope) == ARROW
