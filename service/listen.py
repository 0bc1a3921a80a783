"""Take the port, and run the server on it until a signal says stop."""

from __future__ import annotations

import ipaddress
import signal
import socket
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from errno import EADDRINUSE
from types import FrameType

import uvicorn
from fastapi import FastAPI

from model.exceptions import ComputeError, InputError
from service.settings import Settings

GRACE_S = 5
"""How long requests under way may take after the signal to stop [s]; the longest takes half a second."""


def check_host(settings: Settings) -> None:
    """Refuse to listen where others can reach it, unless told to.

    Raises
    ------
    InputError
        where the host is not a loopback address and `allow_remote` is not set.
    """
    if settings.allow_remote or settings.host == "localhost":
        return
    try:
        loopback = ipaddress.ip_address(settings.host).is_loopback
    except ValueError:
        loopback = False
    if not loopback:
        raise InputError(
            f"host must be a loopback address such as 127.0.0.1, got '{settings.host}'; the service has no keys "
            "yet, so whoever reaches it can steer the correction; add --allow-remote if that is meant"
        )


def take_port(settings: Settings) -> socket.socket:
    """Return a listening socket, before anything else is started.

    Raises
    ------
    InputError
        where the address is in use, not allowed or not this computer's.
    """
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    try:
        return socket.create_server((settings.host, settings.port), family=family)
    except OSError as problem:
        reason = (problem.strerror or str(problem)).split(" (while", maxsplit=1)[0].lower()
        remedy = f"; stop what listens there or try --port {settings.port + 1}" if problem.errno == EADDRINUSE else ""
        raise InputError(f"cannot listen on {settings.host}, port {settings.port}: {reason}{remedy}") from None


def address(listener: socket.socket) -> str:
    """Return where the service is to be found; for a wildcard address, on this computer."""
    host, port = listener.getsockname()[:2]
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)  # noqa: S104 (read, not bound)
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def run(app: FastAPI, listener: socket.socket, settings: Settings, ready: Callable[[], None]) -> None:
    """Serve until SIGTERM or SIGINT; `ready` is called once requests are answered.

    Raises
    ------
    ComputeError
        where the server does not start.
    """
    config = uvicorn.Config(
        app,
        log_config=None,  # and no level either: it would undo what `service.logs` has set
        access_log=settings.access_log,
        server_header=False,
        timeout_graceful_shutdown=GRACE_S,
    )
    server = _Server(config, ready)
    server.run(sockets=[listener])
    if not server.started:
        raise ComputeError("the server must start, and did not; its log says why")


class _Server(uvicorn.Server):
    def __init__(self, config: uvicorn.Config, ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._ready = ready

    @contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        # Once it has shut down it raises the signal again, for the process to end with; here it has ended well.
        with suppress(SystemExit):
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, _leave)
            with super().capture_signals():
                yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started:
            self._ready()


def _leave(number: int, frame: FrameType | None) -> None:
    raise SystemExit(0)
