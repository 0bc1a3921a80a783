"""Security headers, for a browser that shows an answer: nothing is stored, guessed, framed or told to others."""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.page import PAGE

_ALWAYS = [(b"x-content-type-options", b"nosniff"), (b"referrer-policy", b"no-referrer")]
_CACHE, _POLICY = b"cache-control", b"content-security-policy"
API_POLICY = "default-src 'none'; frame-ancestors 'none'"
DOCS_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Swagger UI starts from a script in its page, styles itself, and calls this service and no other."""
PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
_API = [(_CACHE, b"no-store"), (_POLICY, API_POLICY.encode())]
_DOCS = [(_CACHE, b"no-cache"), (_POLICY, DOCS_POLICY.encode())]
_PAGE = [(_CACHE, b"no-cache"), (_POLICY, PAGE_POLICY.encode())]


class SecurityHeaders:
    """ASGI middleware that adds the headers to every answer; what an answer says of its caching stays."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and add the headers to its answer."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        path = scope["path"]
        wanted = _DOCS if path == "/docs" or path.startswith("/docs/") else _PAGE if path in PAGE else _API

        async def secured(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = list(message.get("headers", ()))
                said = {key.lower() for key, _ in headers}
                message["headers"] = headers + _ALWAYS + [(key, value) for key, value in wanted if key not in said]
            await send(message)

        await self._app(scope, receive, secured)
