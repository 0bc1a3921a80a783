"""A request's body as a file that a thread reads, while the loop that receives it does other things."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import CancelledError, Future
from http import HTTPStatus
from typing import Any

from starlette.types import Message, Receive

from service.problems import Problem, unprocessable

IDLE_S = 30.0
"""How long to wait for more of the body [s]; a thread waits along."""


class Left(Exception):
    """The client has left, or the service stops."""

    def __init__(self) -> None:
        super().__init__("the client has left")


class Body:
    """The body of one request.

    Parameters
    ----------
    receive : of the request
    loop : that it is called by

    Attributes
    ----------
    failure : why reading failed
    """

    def __init__(self, receive: Receive, loop: asyncio.AbstractEventLoop) -> None:
        self._receive, self._loop = receive, loop
        self._chunk = memoryview(b"")
        self._over = False
        self._most, self._what = 0, ""
        self._lock = threading.Lock()
        self._left = False
        self._waiting: Future[Message] | None = None
        self.failure: Exception | None = None

    def expect(self, most: int, what: str) -> None:
        """Read no more than so many bytes until called again; `what` they are, for the message."""
        self._most, self._what = most, what

    def readinto(self, buffer: Any) -> int:
        """Fill the buffer, or as much of it as the body still has; return how much.

        Raises
        ------
        Problem
            where that is more than expected, or nothing comes.
        Left
            where nobody is there to read for.
        """
        try:
            return self._fill(memoryview(buffer).cast("B"))
        except Exception as problem:
            self.failure = problem
            raise

    def leave(self) -> None:
        """Let a thread that waits for more wait no longer."""
        with self._lock:
            self._left = True
            if self._waiting is not None:
                self._waiting.cancel()

    def _fill(self, view: memoryview) -> int:
        self._most -= len(view)
        if self._most < 0:
            raise unprocessable(f"a batch must have at most {self._what}, got a longer one; send smaller ones")
        filled = 0
        while filled < len(view):
            if not self._chunk and not self._fetch():
                break
            part = self._chunk[: len(view) - filled]
            view[filled : filled + len(part)] = part
            self._chunk = self._chunk[len(part) :]
            filled += len(part)
        return filled

    def _fetch(self) -> bool:
        """Wait for the next chunk; False at the end."""
        if self._over:
            return False
        with self._lock:
            if self._left:
                raise Left
            self._waiting = asyncio.run_coroutine_threadsafe(self._next(), self._loop)
        try:
            message = self._waiting.result()
        except CancelledError:
            raise Left from None
        except TimeoutError:
            detail = f"the body must go on within {IDLE_S:g} s, and nothing came; send it again"
            raise Problem(HTTPStatus.REQUEST_TIMEOUT, "request-timeout", detail) from None
        if message["type"] == "http.disconnect":
            raise Left
        self._chunk = memoryview(message.get("body", b""))
        self._over = not message.get("more_body", False)
        return True

    async def _next(self) -> Message:
        async with asyncio.timeout(IDLE_S):
            return await self._receive()
