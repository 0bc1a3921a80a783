"""How fast the service answers, and how much it takes: `python bench/serving.py [SECTION ...]`, all without one.

Client and server share the computer's cores, so every
figure has the client's own work in it; ratios are of servers that are asked in turns in one run.
"""

from __future__ import annotations

import http.client
import json
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa
from serving_http import Connection
from serving_machines import POSITION_OF, write_copies
from serving_servers import HOST, POSITION, Server, script, service
from websockets.sync.client import connect

DEMO = Path(__file__).parents[1] / "demo" / "vmc3"
MACHINE = "vmc3"
PATH = f"/v1/machines/{MACHINE}/compensate"
ROUNDS, IN_A_ROW = 20, 500
LITSERVE_ROUNDS, LITSERVE_IN_A_ROW = 5, 100
MACHINES, TELEMETRY_HZ, LOAD_S, ASKED_HZ = 100, 10, 20.0, 100
LOOP_HZ, LOOP_S = 500, 60.0
BULK_BATCHES, BATCH = 160, 65536
MANY = 1000


def main() -> None:
    """Run the sections named."""
    sys.setswitchinterval(1e-4)  # what one thread of the client does must not show in the times of another
    sections: dict[str, Callable[[Path], None]] = {
        "latency": latency,
        "load": load,
        "websocket": websocket,
        "bulk": bulk,
        "machines": machines,
        "litserve": litserve,
    }
    for name in sys.argv[1:] or list(sections):
        with tempfile.TemporaryDirectory() as folder:
            sections[name](Path(folder))


def latency(folder: Path) -> None:
    """One position over one connection, beside an empty FastAPI route with the same records; keys are on."""
    body = {"positions": [POSITION]}
    with service([DEMO], folder) as ours, script("serving_empty.py") as empty:
        _warm(ours, MACHINE)
        a, b = _in_turns(ours, empty, PATH, body, ROUNDS, IN_A_ROW)
    _compare("latency: an empty FastAPI route", a, b)


def litserve(folder: Path) -> None:
    """The same request to LitServe, which runs the same network and compensates."""
    with service([DEMO], folder) as ours, script("serving_litserve.py", str(DEMO)) as other:
        _warm(ours, MACHINE)
        turns = LITSERVE_ROUNDS, LITSERVE_IN_A_ROW
        a, b = _in_turns(ours, other, PATH, {"positions": [POSITION]}, *turns, other_path="/predict")
    _compare("litserve: LitServe with the same network", a, b)


def load(folder: Path) -> None:
    """The latency of single positions while the telemetry of many machines comes in, one sample a request."""
    bundles = write_copies(folder / "bundles", MACHINES)
    with service(bundles, folder) as server:
        names = [bundle.name for bundle in bundles]
        for name in names:
            _warm(server, name)
        asked = Connection(server)
        requests = [asked.post(f"/v1/machines/{name}/compensate", {"positions": [POSITION_OF]}) for name in names]
        with _gateways(server, names) as counts:
            time.sleep(2.0)
            times, began_s, before = [], time.perf_counter(), len(counts)
            while time.perf_counter() - began_s < LOAD_S:
                times += asked.time_s(requests[len(times) % len(names)], 1)
                time.sleep(max(0.0, began_s + len(times) / ASKED_HZ - time.perf_counter()))
            rate = (counts[-1] - counts[before - 1]) / (len(counts) - before)
    print(
        f"load: {MACHINES} machines, {rate:.0f} samples a second of {MACHINES * TELEMETRY_HZ}: compensate takes "
        f"{_ms(times)}"
    )


@contextmanager
def _gateways(server: Server, names: list[str]) -> Iterator[list[int]]:
    """Send telemetry of machines from a process of its own; gives how many samples were stored, after each second."""
    orders = {
        "port": server.port,
        "headers": server.headers,
        "hz": TELEMETRY_HZ,
        "machines": names,
        "temperatures": _sample(time.time())["temperatures"],
    }
    command = [sys.executable, str(Path(__file__).with_name("serving_telemetry.py"))]
    counts: list[int] = []
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(orders) + "\n")
        process.stdin.flush()
        lines = process.stdout
        reader = threading.Thread(target=lambda: counts.extend(int(line) for line in lines))
        reader.start()
        try:
            yield counts
        finally:
            process.terminate()
            reader.join()


def _send_telemetry(server: Server, names: list[str], stop: threading.Event, sent: list[int], hz: float) -> None:
    connections = [Connection(server) for _ in range(4)]
    began_s = time.perf_counter()
    while not stop.is_set():
        for number, name in enumerate(names):
            connection = connections[number % len(connections)]
            connection.ask(connection.post(f"/v1/machines/{name}/telemetry", {"samples": [_sample(time.time())]}))
            sent[0] += 1
            time.sleep(max(0.0, began_s + sent[0] / (hz * len(names)) - time.perf_counter()))


def websocket(folder: Path) -> None:
    """A control loop: one position every two milliseconds, binary, while telemetry comes in."""
    with service([DEMO], folder) as server:
        _warm(server, MACHINE)
        for telemetry_hz, seconds in ((1, LOOP_S), (TELEMETRY_HZ, LOOP_S / 3.0)):
            _control_loop(server, telemetry_hz, seconds)


def _control_loop(server: Server, telemetry_hz: float, seconds: float) -> None:
    url = f"ws://{HOST}:{server.port}/v1/machines/{MACHINE}/stream"
    stop, sent = threading.Event(), [0]
    sender = threading.Thread(target=_send_telemetry, args=(server, [MACHINE], stop, sent, telemetry_hz))
    sender.start()
    q, times, lost = np.array([list(POSITION.values())]), [], 0
    with connect(url, additional_headers=server.headers, compression=None, ping_interval=None) as stream:
        stream.send('{"format": "binary"}')
        stream.recv()
        began_s = time.perf_counter()
        for number in range(int(LOOP_HZ * seconds)):
            due_s = began_s + number / LOOP_HZ
            time.sleep(max(0.0, due_s - time.perf_counter()))
            q[0, 0] = number % 800
            asked_s = time.perf_counter()
            stream.send(q.tobytes())
            reply = np.frombuffer(stream.recv(), dtype="<f8", offset=16)
            times.append(time.perf_counter() - asked_s)
            lost += abs(reply[0] - q[0, 0]) > 0.3
    stop.set()
    sender.join()
    told = f"{len(times)} positions at {LOOP_HZ} Hz, telemetry at {telemetry_hz} Hz"
    print(f"websocket: {told}, {lost} lost: {_ms(times)}")


def bulk(folder: Path) -> None:
    """Positions of three axes through HTTP as Arrow streams, both ways at a time."""
    q = np.random.default_rng(0).uniform(0.0, [800.0, 500.0, 500.0], (BATCH, 3))
    table = pa.table({axis: q[:, i] for i, axis in enumerate("XYZ")})
    with service([DEMO], folder) as server:
        _warm(server, MACHINE)
        connection = http.client.HTTPConnection(HOST, server.port)
        began_s = time.perf_counter()
        connection.putrequest("POST", PATH)
        for key, value in (server.headers | {"Content-Type": "application/vnd.apache.arrow.stream"}).items():
            connection.putheader(key, value)
        connection.putheader("Transfer-Encoding", "chunked")
        connection.endheaders()
        sender = threading.Thread(target=_send_batches, args=(connection, table))
        sender.start()
        with connection.getresponse() as answer:
            rows = sum(batch.num_rows for batch in pa.ipc.open_stream(answer))
        took_s = time.perf_counter() - began_s
        sender.join()
        connection.close()
        print(
            f"bulk: {rows} positions in {took_s:.1f} s: {rows / took_s / 1e6:.2f} million a second; {_memory(server)}"
        )


def _send_batches(connection: http.client.HTTPConnection, table: pa.Table) -> None:
    class Chunks:
        closed = False

        def write(self, data: bytes) -> int:
            connection.send(b"%x\r\n" % len(data))
            connection.send(data)
            connection.send(b"\r\n")
            return len(data)

        def flush(self) -> None:
            pass

    with pa.ipc.new_stream(pa.PythonFile(Chunks(), mode="w"), table.schema) as writer:
        for _ in range(BULK_BATCHES):
            writer.write_table(table)
    connection.send(b"0\r\n\r\n")


def machines(folder: Path) -> None:
    """Memory and start of one machine, and of a thousand that each have telemetry and have corrected once."""
    with service([DEMO], folder) as server:
        _warm(server, MACHINE)
        Connection(server).time_s(_position(server, MACHINE), 100)
        print(f"machines: 1, ready in {server.ready_s:.1f} s; {_memory(server)}")
    bundles = write_copies(folder / "bundles", MANY)
    with ExitStack() as stack:
        (folder / "many").mkdir()
        server = stack.enter_context(service(bundles, folder / "many"))
        started = _memory(server)
        asked = Connection(server)
        for bundle in bundles:
            _warm(server, bundle.name, asked)
            asked.time_s(_position(server, bundle.name), 1)
        print(f"machines: {MANY}, ready in {server.ready_s:.1f} s with {started}; at work {_memory(server)}")


def _position(server: Server, name: str) -> bytes:
    return Connection(server).post(f"/v1/machines/{name}/compensate", {"positions": [POSITION]})


def _warm(server: Server, name: str, connection: Connection | None = None) -> None:
    """Give a machine a thermal state: an hour of telemetry up to now."""
    connection = connection or Connection(server)
    samples = [_sample(time.time() - 60.0 * ago) for ago in range(60, -1, -1)]
    status, said = connection.ask(connection.post(f"/v1/machines/{name}/telemetry", {"samples": samples}))
    if status != 200:
        raise SystemExit(f"telemetry must be taken, got {status}: {said.decode()}")


SENSORS: dict[str, float] = {}


def _sample(time_s: float) -> dict[str, object]:
    if not SENSORS:
        manifest = json.loads((DEMO / "manifest.json").read_text(encoding="utf-8"))["network"]
        SENSORS.update({n: sum(manifest["valid_range_degC"][n]) / 2.0 for n in manifest["sensors"]})
    return {"time": time_s, "temperatures": {n: v + 0.2 * np.sin(time_s / 300.0) for n, v in SENSORS.items()}}


def _in_turns(
    ours: Server, other: Server, path: str, body: object, rounds: int, in_a_row: int, other_path: str | None = None
) -> tuple[list[float], list[float]]:
    """Return how long each request took [s], of both servers, asked in turns."""
    a, b = Connection(ours), Connection(other)
    first, second = a.post(path, body), b.post(other_path or path, body)
    a.time_s(first, in_a_row)
    b.time_s(second, in_a_row)
    of_ours: list[float] = []
    of_other: list[float] = []
    for _ in range(rounds):
        of_ours += a.time_s(first, in_a_row)
        of_other += b.time_s(second, in_a_row)
    return of_ours, of_other


def _compare(what: str, ours: list[float], other: list[float]) -> None:
    median = statistics.median(ours) / statistics.median(other)
    rate = sum(other) / sum(ours)
    print(f"{what}: median {median:.2f} times, requests a second {rate:.2f} times; ours {_ms(ours)}, its {_ms(other)}")


def _ms(times: list[float]) -> str:
    median, late = np.percentile(times, [50, 99]) * 1e3
    return f"median {median:.2f} ms, p99 {late:.2f} ms"


def _memory(server: Server) -> str:
    return f"{server.rss_mb():.0f} MB"


if __name__ == "__main__":
    main()
