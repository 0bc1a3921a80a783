"""Refuse request bodies that are too large, before they fill the memory."""

from __future__ import annotations

from http import HTTPStatus

from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MAX_BODY_BYTES = 8 * 1024 * 1024
"""The largest telemetry request of a machine with 60 sensors has 6 MB; parsed, a body takes ten times its size."""


class BodyLimit:
    """ASGI middleware that ends a request whose body is longer than `MAX_BODY_BYTES`.

    It raises where the body is read, so the answer is made where all others are.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, counting the bytes that are read of its body."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        declared = dict(scope["headers"]).get(b"content-length", b"0")
        read = int(declared) if declared.isdigit() and int(declared) > MAX_BODY_BYTES else 0

        async def counted() -> Message:
            nonlocal read
            if read <= MAX_BODY_BYTES:
                message = await receive()
                read += len(message.get("body", b""))
            if read > MAX_BODY_BYTES:
                detail = f"the body must be at most {MAX_BODY_BYTES} bytes, got more; send it in parts"
                raise HTTPException(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, detail)
            return message

        await self._app(scope, counted, send)
