"""Servers for `bench/serving.py`, each a process of its own: the service, and what it is compared with."""

from __future__ import annotations

import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

HOST = "127.0.0.1"
POSITION = {"X": 400.0, "Y": 250.0, "Z": 250.0}
START_S = 120.0
"""How long a server may take to answer [s]; a loaded computer starts a thousand machines slowly."""


@dataclass(frozen=True)
class Server:
    """A running server: its process, its port, the headers that it wants, how long it took to be ready [s]."""

    process: subprocess.Popen[bytes]
    port: int
    headers: dict[str, str]
    ready_s: float

    def rss_mb(self) -> float:
        """Return its resident memory, with that of its children [MB of 10^6 bytes]."""
        return sum(_rss_mb(pid) for pid in [self.process.pid, *_children(self.process.pid)])


@contextmanager
def service(bundles: list[Path], folder: Path, *options: str) -> Iterator[Server]:
    """Run `thermotrue serve` with keys, its database on disk in `folder`, and no limit of requests a second."""
    command = str(Path(sys.executable).with_name("thermotrue"))
    database = f"sqlite:///{folder / 'service.db'}"
    made = subprocess.run(
        [command, "keys", "create", "bench", "--role", "gateway", "--database", database],
        capture_output=True,
        text=True,
        check=True,
    )
    settings = ("--database", database, "--max-requests-per-s", "0", "--log-level", "error", *options)
    environment = os.environ | {"THERMOTRUE_BUNDLES": os.pathsep.join(map(str, bundles))}
    headers = {"Authorization": f"Bearer {made.stdout.strip()}"}
    with _running([command, "serve", *settings], environment, headers) as server:
        yield server


@contextmanager
def script(name: str, *args: str) -> Iterator[Server]:
    """Run one of the servers in this folder that the service is compared with."""
    with _running([sys.executable, str(Path(__file__).with_name(name)), *args], dict(os.environ), {}) as server:
        yield server


@contextmanager
def _running(command: list[str], environment: dict[str, str], headers: dict[str, str]) -> Iterator[Server]:
    port = _free_port()
    began_s = time.perf_counter()
    process = subprocess.Popen([*command, "--port", str(port)], env=environment, stdout=subprocess.DEVNULL)
    try:
        ready_s = _wait(process, port, began_s)
        yield Server(process, port, headers, ready_s)
    finally:
        children = _children(process.pid)
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for child in children:  # those that outlive it, as LitServe's workers do
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)


def _free_port() -> int:
    with socket.create_server((HOST, 0)) as listener:
        return int(listener.getsockname()[1])


def _wait(process: subprocess.Popen[bytes], port: int, began_s: float) -> float:
    """Return how long it took until the server answered that it is ready."""
    while time.perf_counter() - began_s < START_S:
        if process.poll() is not None:
            raise SystemExit(f"the server must run, and ended with {process.returncode}")
        try:
            with socket.create_connection((HOST, port), timeout=5.0) as connection:
                connection.sendall(b"GET /readyz HTTP/1.1\r\nHost: bench\r\nConnection: close\r\n\r\n")
                select.select([connection], [], [], 5.0)
                if connection.recv(4096).split(b" ", 2)[1] == b"200":
                    return time.perf_counter() - began_s
        except (OSError, IndexError):
            pass
        time.sleep(0.02)
    raise SystemExit(f"the server must be ready within {START_S:g} s, and is not")


def _children(pid: int) -> list[int]:
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in map(int, task.read_text().split()):
            found += [child, *_children(child)]
    return found


def _rss_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
