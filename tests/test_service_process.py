"""The command `thermotrue serve` as a user meets it: a process, a port, a shell."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from service_client import TINY

THERMOTRUE = str(Path(sys.executable).with_name("thermotrue"))


def start(*args: str) -> tuple[subprocess.Popen[str], list[str]]:
    """Start the service and return it once it has printed its greeting."""
    process = subprocess.Popen([THERMOTRUE, "serve", *args], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    lines: list[str] = []
    for line in process.stdout:
        lines.append(line.rstrip("\n"))
        if line.startswith("all calls: "):
            break
    return process, lines


@pytest.fixture
def served() -> Iterator[tuple[subprocess.Popen[str], list[str]]]:
    process, lines = start(str(TINY), "--port", "0")
    yield process, lines
    process.kill()
    process.communicate()


def refuse(*args: str, **environment: str) -> str:
    """Run the command, and return the one line that it ends with."""
    done = subprocess.run(
        [THERMOTRUE, "serve", *args],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
        env=os.environ | environment,
    )
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    [line] = done.stderr.splitlines()
    return line


def test_the_greeting_works_when_pasted(served: tuple[subprocess.Popen[str], list[str]]) -> None:
    process, lines = served
    assert lines[0].startswith(f"machine 'tiny' from {TINY}: model ")
    assert lines[0].endswith(", axes X Y Z, 3 sensors")
    address = lines[-1].removeprefix("all calls: ").removesuffix("/docs")
    with urllib.request.urlopen(f"{address}/readyz") as answer:  # noqa: S310 (our own address)
        assert json.load(answer)["status"] == "ready"
    with urllib.request.urlopen(f"{address}/docs") as answer:  # noqa: S310
        assert answer.status == 200
    [curl] = [line for line in lines if line.lstrip().startswith("curl ")]
    assert "temperatures" not in curl
    if shutil.which("curl"):
        pasted = subprocess.run(curl, shell=True, capture_output=True, text=True, check=True)  # noqa: S602
        [point] = json.loads(pasted.stdout)["points"]
        assert point["corrected"]["X"] == pytest.approx(400.0, abs=0.05)
    port = address.rsplit(":", 1)[1]
    line = refuse(str(TINY), "--port", port)
    assert line == (
        f"thermotrue: cannot listen on 127.0.0.1, port {port}: address already in use; stop what listens there "
        f"or try --port {int(port) + 1}"
    )
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=10)
    assert process.returncode == 0
    assert [json.loads(line)["level"] for line in errors.splitlines()].count("error") == 0


def test_the_access_log_names_requests_by_their_ids() -> None:
    process, lines = start(str(TINY), "--port", "0", "--access-log")
    address = lines[-1].removeprefix("all calls: ").removesuffix("/docs")
    ids = []
    for path in ("/healthz", "/readyz"):
        with urllib.request.urlopen(f"{address}{path}") as answer:  # noqa: S310 (our own address)
            ids.append(answer.headers["X-Request-ID"])
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=10)
    told = [line for line in map(json.loads, errors.splitlines()) if "HTTP/1.1" in line["event"]]
    assert [line["request_id"] for line in told] == ids
    assert told[0]["event"].endswith('"GET /healthz HTTP/1.1" 200')


def test_an_interrupt_ends_it_well() -> None:
    process, _ = start(str(TINY), "--port", "0")
    process.send_signal(signal.SIGINT)
    out, errors = process.communicate(timeout=10)
    assert (process.returncode, out) == (0, "")
    assert "Traceback" not in errors


@pytest.mark.parametrize(
    ("args", "line"),
    [
        ((), "name at least one bundle to serve, such as `thermotrue serve demo/vmc3`"),
        (
            ("nowhere", "--port", "0"),
            "bundle 'nowhere' must be a folder with machine.toml and manifest.json; there is",
        ),
        (
            (str(TINY), str(TINY), "--port", "0"),
            f"machine 'tiny' must be served from one bundle, got '{TINY}' and '{TINY}'; leave one out",
        ),
        (
            (str(TINY), "--host", "192.0.2.1", "--database", "sqlite:///never.db"),
            "TLS must be on beyond loopback, on '192.0.2.1', got no certificate, and keys would travel in the clear",
        ),
        ((str(TINY), "--port", "70000"), "key 'port' in the settings"),
    ],
)
def test_a_wrong_call_gets_one_sentence(args: tuple[str, ...], line: str) -> None:
    assert refuse(*args).startswith(f"thermotrue: {line}")


def test_a_taken_port_starts_nothing() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        line = refuse("nowhere", THERMOTRUE_PORT=port)
    assert line.startswith(f"thermotrue: cannot listen on 127.0.0.1, port {port}: address already in use")
