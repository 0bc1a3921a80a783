"""Take the port, and run the server on it until a signal says stop."""

from __future__ import annotations

import signal
import socket
import ssl
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from errno import EADDRINUSE
from pathlib import Path
from types import FrameType

import uvicorn
from fastapi import FastAPI

from model.exceptions import ComputeError, InputError
from service.settings import Settings, is_loopback
from service.stream.streams import Streams

IN_MEMORY = ("sqlite://", "sqlite:///:memory:")
MAX_MESSAGE_BYTES = 2**20
"""Longest message of a stream: the most positions that one may hold, as JSON, five times over."""
SWITCH_S = 0.0005
"""How long another thread may keep the loop waiting [s]: one that reads keys or writes rows, ten times as long by
Python's default. A control loop at 500 Hz feels 5 ms."""
GRACE_S = 5
"""How long requests under way may take after the signal to stop [s]; the longest takes half a second."""


def check_host(settings: Settings) -> None:
    """Refuse to listen where others can reach it without keys or without TLS, unless told to.

    Raises
    ------
    InputError
        with what has to be set where the host is not a loopback address, or where half of TLS is set.
    """
    check_tls(settings)
    if is_loopback(settings.host):
        return
    where = f"beyond loopback, on '{settings.host}',"
    if settings.keys != "off" and settings.database_url in IN_MEMORY:
        raise InputError(
            f"keys must be kept in a database that lasts {where} got one in memory; give --database or --data-dir a "
            "place, or leave --replay out"
        )
    if settings.keys == "off" and not settings.allow_open:
        raise InputError(
            f"keys must be required {where} got keys 'off': whoever reaches the service could steer the correction; "
            "leave --keys off out, or add --allow-open if that is meant"
        )
    if settings.tls_cert is None and not settings.allow_plain_http:
        raise InputError(
            f"TLS must be on {where} got no certificate, and keys would travel in the clear; give --tls-cert and "
            "--tls-key, or add --allow-plain-http where something in between does it"
        )


def check_tls(settings: Settings) -> None:
    """Refuse a certificate and key that no server could start with."""
    given = {"--tls-cert": settings.tls_cert, "--tls-key": settings.tls_key}
    missing = [option for option, path in given.items() if path is None]
    if len(missing) == 1:
        [other] = given.keys() - set(missing)
        raise InputError(f"--tls-cert and --tls-key must be given together, got {other} alone; add {missing[0]}")
    if settings.tls_cert is None or settings.tls_key is None:
        return
    for option, path in given.items():
        try:
            Path(str(path)).read_bytes()
        except OSError as problem:
            raise InputError(
                f"{option} must be a readable file, got '{path}': {(problem.strerror or '').lower()}"
            ) from None

    def no_password() -> str:
        raise InputError(f"--tls-key must not be encrypted, got '{settings.tls_key}'; a service starts without people")

    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(settings.tls_cert, settings.tls_key, no_password)
    except ssl.SSLError as problem:
        reason = (problem.reason or str(problem)).lower().replace("_", " ")
        raise InputError(
            f"--tls-cert and --tls-key must be a PEM certificate and its key, got '{settings.tls_cert}' and "
            f"'{settings.tls_key}': {reason}"
        ) from None


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


def address(listener: socket.socket, settings: Settings) -> str:
    """Return where the service is to be found; for a wildcard address, on this computer."""
    scheme = "http" if settings.tls_cert is None else "https"
    host, port = listener.getsockname()[:2]
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)  # noqa: S104 (read, not bound)
    return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"


def run(app: FastAPI, listener: socket.socket, settings: Settings, ready: Callable[[], None]) -> None:
    """Serve until SIGTERM or SIGINT; `ready` is called once requests are answered.

    Raises
    ------
    ComputeError
        where the server does not start.
    """
    sys.setswitchinterval(SWITCH_S)
    config = uvicorn.Config(
        app,
        log_config=None,  # and no level either: it would undo what `service.logs` has set
        access_log=settings.access_log,
        server_header=False,
        ws_max_size=MAX_MESSAGE_BYTES,
        ws_per_message_deflate=False,  # it takes longer than what it saves to send
        ssl_certfile=settings.tls_cert,
        ssl_keyfile=settings.tls_key,
        timeout_graceful_shutdown=GRACE_S,
    )
    server = _Server(config, ready, getattr(app.state, "streams", Streams()))
    server.run(sockets=[listener])
    if not server.started:
        raise ComputeError("the server must start, and did not; its log says why")


class _Server(uvicorn.Server):
    def __init__(self, config: uvicorn.Config, ready: Callable[[], None], streams: Streams) -> None:
        super().__init__(config)
        self._ready, self._streams = ready, streams

    @contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        # Once it has shut down it raises the signal again, for the process to end with; here it has ended well.
        with suppress(SystemExit):
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, _leave)
            with super().capture_signals():
                yield

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        await self._streams.close()  # the server's own code for it would say that it comes back at once
        await super().shutdown(sockets)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started:
            self._ready()


def _leave(number: int, frame: FrameType | None) -> None:
    raise SystemExit(0)
