"""The gate: who calls, found out before anything of the request is read."""

from __future__ import annotations

import base64
import binascii
import logging
import time
from http import HTTPStatus

from starlette.types import ASGIApp, Receive, Scope, Send

from service.access.keyring import KeyRing
from service.access.origin import foreign_origin
from service.access.roles import PASSER_BY, Caller
from service.page import PAGE
from service.problems import Problem, refuse

log = logging.getLogger(__name__)

OPEN = frozenset({"/healthz", "/readyz"}) | PAGE
"""What a supervisor asks, which has no key: it tells nothing but whether the service works. And the page, which knows
nothing itself: it asks for the key that it then calls with."""
BROWSED = ("/docs", "/openapi.json")
"""What people open in a browser, which asks for a password and not for a header: the key goes there, under any name.
Only for these: a browser sends a password along with whatever another site makes it ask."""
_LOG_EVERY_S = 10.0


class Gate:
    """ASGI middleware that finds out who calls, puts it into the request's state, and lets nobody else through."""

    def __init__(self, app: ASGIApp, ring: KeyRing) -> None:
        self._app, self._ring = app, ring
        self._refused, self._logged_s = 0, float("-inf")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on with its caller, or answer with a problem."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        try:
            caller = self._caller(scope)
        except Problem as problem:
            self._tell(scope, problem)
            await refuse(problem, scope, receive, send)
            return
        scope.setdefault("state", {})["caller"] = caller
        await self._app(scope, receive, send)

    def _caller(self, scope: Scope) -> Caller:
        path: str = scope["path"]
        if path in OPEN:
            return PASSER_BY
        anyone = self._ring.anyone()
        if anyone is not None:
            site = foreign_origin(scope)
            if site is not None:
                raise Problem(
                    HTTPStatus.FORBIDDEN,
                    "foreign-origin",
                    f"without keys a page in a browser must be the service's own to call it, got one of '{site}'; "
                    "make keys with `thermotrue keys create`",
                )
            return anyone
        browsed = path.startswith(BROWSED)
        given = [value for name, value in scope["headers"] if name == b"authorization"]
        key = _key(given[0], browsed=browsed) if len(given) == 1 else None
        if key is None:
            came = "another header or several" if given else "none"
            raise _unauthorized(
                "no-key", f"a key must come as 'Authorization: Bearer KEY', got {came}", browsed=browsed
            )
        caller = self._ring.caller(key)
        if caller is None:
            raise _unauthorized(
                "wrong-key", "the key must be one made here and not revoked, got another", browsed=browsed
            )
        return caller

    def _tell(self, scope: Scope, problem: Problem) -> None:
        """Log that somebody was refused, now and then: who tries in a loop must not fill a disk."""
        self._refused += 1
        now_s = time.monotonic()
        if now_s - self._logged_s >= _LOG_EVERY_S:
            client = scope.get("client")
            carried = {"kind": problem.kind, "client": client[0] if client else None, "refused": self._refused}
            log.warning("callers refused", extra=carried)
            self._refused, self._logged_s = 0, now_s


def _key(header: bytes, *, browsed: bool) -> str | None:
    """Return the key in an Authorization header; None where there is none in it."""
    scheme, _, value = header.decode("latin-1").partition(" ")
    if scheme.lower() == "bearer":
        return value.strip()
    if browsed and scheme.lower() == "basic":
        try:
            return base64.b64decode(value, validate=True).decode("latin-1").partition(":")[2]
        except binascii.Error:
            return None
    return None


def _unauthorized(kind: str, detail: str, *, browsed: bool) -> Problem:
    ways = 'Bearer realm="thermotrue"' + (', error="invalid_token"' if kind == "wrong-key" else "")
    if browsed:
        ways = 'Basic realm="thermotrue: any user name, the key as the password", ' + ways
    remedy = "make one: thermotrue keys create NAME --role gateway"
    return Problem(HTTPStatus.UNAUTHORIZED, kind, f"{detail}; {remedy}", {"WWW-Authenticate": ways})
