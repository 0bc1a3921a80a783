"""How many requests a caller may make: a bucket of tokens for each key, or each address where keys are off."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from http import HTTPStatus

from starlette.types import ASGIApp, Receive, Scope, Send

from service.access.gate import OPEN
from service.problems import Problem, refuse

BURST_S = 1.0
"""How long a caller that was quiet may go at any speed, until a second's worth of requests is used up [s]."""
MAX_BUCKETS = 10_000
"""An address costs nothing, so buckets that are full again go, and beyond this number the oldest as well."""
_ONE = 1.0 - 1e-6
"""A token, less what adding up seconds loses: who waits as long as told must get it."""


class RateLimit:
    """ASGI middleware that answers 429 to callers that ask for more than so many requests a second."""

    def __init__(self, app: ASGIApp, per_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._app, self._per_s, self._clock = app, per_s, clock
        self._most = max(per_s * BURST_S, 1.0)
        self._buckets: dict[str, tuple[float, float]] = {}  # who: tokens, and when that was

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or answer with a problem."""
        if scope["type"] != "lifespan" and self._per_s > 0 and scope["path"] not in OPEN:
            wait_s = self.take(_who(scope))
            if wait_s > 0:
                await refuse(_too_many(self._per_s, wait_s), scope, receive, send)
                return
        await self._app(scope, receive, send)

    def take(self, who: str) -> float:
        """Take a token; return 0, or how long until there is one again [s]."""
        now_s = self._clock()
        tokens, then_s = self._buckets.get(who, (self._most, now_s))
        tokens = min(tokens + (now_s - then_s) * self._per_s, self._most)
        if tokens < _ONE:
            return (1.0 - tokens) / self._per_s
        if who not in self._buckets and len(self._buckets) >= MAX_BUCKETS:
            self._shrink(now_s)
        self._buckets[who] = (tokens - 1.0, now_s)
        return 0.0

    def _shrink(self, now_s: float) -> None:
        """Drop the buckets that are full again, and where that is not enough the half that was used longest ago."""
        ages = {who: then_s for who, (tokens, then_s) in self._buckets.items() if self._needed(tokens, then_s, now_s)}
        newest = sorted(ages, key=ages.__getitem__, reverse=True)[: MAX_BUCKETS // 2]
        self._buckets = {who: self._buckets[who] for who in newest}

    def _needed(self, tokens: float, then_s: float, now_s: float) -> bool:
        return tokens + (now_s - then_s) * self._per_s < self._most


def _who(scope: Scope) -> str:
    key_id: str | None = scope["state"]["caller"].key_id
    if key_id is not None:
        return key_id
    client = scope.get("client")
    return f"at {client[0]}" if client else "somebody"


def _too_many(per_s: float, wait_s: float) -> Problem:
    seconds = math.ceil(wait_s)
    return Problem(
        HTTPStatus.TOO_MANY_REQUESTS,
        "too-many-requests",
        f"one caller may make {per_s:g} requests a second, got more; wait {seconds} s, or put several positions or "
        "samples into one request",
        {"Retry-After": str(seconds)},
    )
