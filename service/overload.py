"""Overload: more requests than one loop can answer get 503 at once, and telemetry goes before them.

Computing does not await, so requests that came together would be computed together, and whatever comes in meanwhile
would wait for all of them. Hence turns: in one step of the loop no more is computed than takes `STEP_S`, and between
steps the loop looks at its connections, where telemetry has come in. Telemetry takes no turn. What has to wait for one
is bounded; who comes beyond that is told at once to come again.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from http import HTTPStatus

from starlette.types import ASGIApp, Receive, Scope, Send

from service.access.gate import OPEN
from service.problems import Problem, refuse

STEP_S = 0.01
"""How much is computed before the loop looks at its connections again [s]; half a period of telemetry at 50 Hz."""
MAX_PER_STEP = 16
FREE = OPEN | {"/metrics"}
"""What must be seen most when there is too much to do."""
FIRST = ("/telemetry", "/datum", "/measurements")
"""How the paths end of what cannot be asked for again later, and so goes first."""


class Turns:
    """Lets through what fits into `STEP_S`, in the order in which it came, and then lets the loop look around."""

    def __init__(self) -> None:
        self._waiting: deque[asyncio.Future[None]] = deque()
        self._stepping = False  # whether a step is to come, for which whoever comes now has to wait
        self._step_s = float("-inf")
        self._usual_s = STEP_S

    async def take(self) -> None:
        """Return when it is the caller's turn."""
        if not self.free():
            await self.wait()

    def free(self) -> bool:
        """Take a turn and return True, where nobody waits for one."""
        if self._stepping:
            return False
        if time.perf_counter() - self._step_s > STEP_S:
            self._stepping = True
            asyncio.get_running_loop().call_soon(self._step)
        return True

    async def wait(self) -> None:
        """Return when it is the caller's turn; `free` must have told to wait."""
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.append(turn)
        await turn

    def took(self, seconds: float) -> None:
        """Tell how long something computed after its turn, for the steps to come."""
        self._usual_s += 0.1 * (min(seconds, 1.0) - self._usual_s)

    def _step(self) -> None:
        """Begin a step: those let through run before the next one begins, and before them the loop looks around."""
        self._step_s = time.perf_counter()
        left = max(1, min(int(STEP_S / max(self._usual_s, 1e-6)), MAX_PER_STEP))
        woken = False
        while self._waiting and left > 0:
            turn = self._waiting.popleft()
            if not turn.done():  # who has left needs none
                turn.set_result(None)
                left -= 1
                woken = True
        self._stepping = woken  # they run after this, and who comes meanwhile must not overtake them
        if woken:
            asyncio.get_running_loop().call_soon(self._step)


class Overload:
    """ASGI middleware that bounds the requests in work, those that compute and those that go first apart."""

    def __init__(self, app: ASGIApp, most: int, most_first: int, turns: Turns) -> None:
        self._app, self._turns = app, turns
        self._most, self._most_first = most, most_first
        self._in_work = self._first_in_work = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on when it is its turn, or answer with a problem."""
        if scope["type"] != "http" or scope["path"] in FREE:
            await self._app(scope, receive, send)
            return
        if scope["path"].endswith(FIRST):
            await self._go_first(scope, receive, send)
            return
        if self._in_work >= self._most:
            await refuse(_overloaded(self._most), scope, receive, send)
            return
        self._in_work += 1
        try:
            if not self._turns.free():
                await self._turns.wait()
            began_s = time.perf_counter()
            await self._app(scope, receive, send)
            self._turns.took(time.perf_counter() - began_s)
        finally:
            self._in_work -= 1

    async def _go_first(self, scope: Scope, receive: Receive, send: Send) -> None:
        if self._first_in_work >= self._most_first:
            await refuse(_overloaded(self._most_first), scope, receive, send)
            return
        self._first_in_work += 1
        try:
            await self._app(scope, receive, send)
        finally:
            self._first_in_work -= 1


def _overloaded(most: int) -> Problem:
    return Problem(
        HTTPStatus.SERVICE_UNAVAILABLE,
        "overloaded",
        f"at most {most} requests of this kind can be in work at a time, and are; try again in a second",
        {"Retry-After": "1"},
    )
