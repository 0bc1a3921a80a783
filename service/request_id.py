"""Request ids: one for every request, in its answer, in problems and in log lines, so that the three can be matched."""

from __future__ import annotations

import re
import secrets
from contextvars import ContextVar

from starlette.types import ASGIApp, Message, Receive, Scope, Send

HEADER = "X-Request-ID"
_KEY = HEADER.lower().encode()
_WELL_FORMED = re.compile(rb"[A-Za-z0-9._:/+=@-]{1,128}")
"""What UUIDs, trace ids and the ids of proxies are written with. Anything else could break a log or a header."""
_STARTS = frozenset({"http.response.start", "websocket.accept", "websocket.http.response.start"})
_current: ContextVar[str | None] = ContextVar("request_id", default=None)


def current() -> str | None:
    """Return the id of the request being answered; None outside of requests."""
    return _current.get()


class RequestIds:
    """ASGI middleware that takes a well-formed `X-Request-ID` over from the client, or makes one."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and add its id to the answer."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        given = next((value for key, value in scope["headers"] if key == _KEY), b"")
        chosen = given if _WELL_FORMED.fullmatch(given) else secrets.token_hex(16).encode()
        # Not reset afterwards: the server logs an exception after this has returned. Each request has its own task.
        _current.set(chosen.decode())

        async def tagged(message: Message) -> None:
            if message["type"] in _STARTS:
                message["headers"] = [*message.get("headers", ()), (_KEY, chosen)]
            await send(message)

        await self._app(scope, receive, tagged)
