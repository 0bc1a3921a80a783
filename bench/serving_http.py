"""A cheap HTTP client for benchmarks: one connection, requests made beforehand, answers read by their length."""

from __future__ import annotations

import json
import socket
import time
from typing import Any

from serving_servers import HOST, Server


class Connection:
    """One connection to a server that is kept open."""

    def __init__(self, server: Server) -> None:
        self._headers = server.headers
        self._socket = socket.create_connection((HOST, server.port), timeout=60.0)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def close(self) -> None:
        """End it."""
        self._socket.close()

    def post(self, path: str, body: Any) -> bytes:
        """Return the bytes of a request."""
        content = json.dumps(body).encode()
        lines = {"Host": "bench", "Content-Type": "application/json", "Content-Length": str(len(content))}
        head = "".join(f"{key}: {value}\r\n" for key, value in (lines | self._headers).items())
        return f"POST {path} HTTP/1.1\r\n{head}\r\n".encode() + content

    def ask(self, request: bytes) -> tuple[int, bytes]:
        """Send a request; return the status and the body of its answer."""
        self._socket.sendall(request)
        data = b""
        while (end := data.find(b"\r\n\r\n")) < 0:
            data += self._more()
        head = data[:end].lower()
        at = head.find(b"content-length:")
        length = int(head[at + 15 : head.find(b"\r", at) if b"\r" in head[at:] else None])
        while len(data) < end + 4 + length:
            data += self._more()
        return int(data[9:12]), data[end + 4 :]

    def time_s(self, request: bytes, count: int) -> list[float]:
        """Return how long each of so many requests took [s]; each must be answered with 200."""
        times = []
        for _ in range(count):
            began_s = time.perf_counter()
            status, body = self.ask(request)
            times.append(time.perf_counter() - began_s)
            if status != 200:
                raise SystemExit(f"requests must be answered with 200, got {status}: {body.decode()}")
        return times

    def _more(self) -> bytes:
        data = self._socket.recv(65536)
        if not data:
            raise SystemExit("the server must keep the connection open, and closed it")
        return data
