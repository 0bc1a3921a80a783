"""Arrow streams in and out of `compensate`; pyarrow, which the service does without, is the independent client."""

import asyncio
import http.client
import io
import json
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from service_client import MIDDLE, NOON, TINY, TINY_URL, Service, assert_problem, sample, serving
from test_service_process import start

from service.problems import Problem, unprocessable
from service.stream import body as body_module
from service.stream.arrow import MAX_BATCH_POSITIONS, PART, Start, corrected
from service.stream.body import Body, Left
from service.stream.envelope import Envelope

ARROW = "application/vnd.apache.arrow.stream"
URL = f"{TINY_URL}/compensate"
HEADERS = {"content-type": ARROW}
Numbers = np.ndarray[Any, np.dtype[np.float64]]


def written(*tables: pa.Table, size: int = PART, options: pa.ipc.IpcWriteOptions | None = None) -> bytes:
    out = io.BytesIO()
    with pa.ipc.new_stream(out, tables[0].schema, options=options) as writer:
        for table in tables:
            writer.write_table(table, max_chunksize=size)
    return out.getvalue()


def table(q: Numbers, names: str = "XYZ") -> pa.Table:
    return pa.table({name: q[:, "XYZ".index(name)] for name in names})


def columns(found: pa.Table, names: list[str]) -> Numbers:
    return np.stack([found[name].to_numpy() for name in names], axis=1)


def positions(n: int, seed: int = 0) -> Numbers:
    return np.random.default_rng(seed).uniform(0.0, [800.0, 500.0, 500.0], (n, 3))


@pytest.fixture
def service() -> Iterator[Service]:
    with serving() as service:
        service.warm(degC=26.0)
        yield service


def ask(service: Service, content: bytes, **query: Any) -> pa.Table:
    answer = service.client.post(URL, content=content, headers=HEADERS, params=query)
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == ARROW
    return pa.ipc.open_stream(answer.content).read_all()


@pytest.mark.parametrize("tool", [None, 220.0])
def test_the_answers_are_those_of_json(service: Service, tool: float | None) -> None:
    q = positions(700)
    found = ask(service, written(table(q), size=300), **({"tool_length_mm": tool} if tool else {}))
    rows = [dict(zip("XYZ", row, strict=True)) for row in q.tolist()]
    reply = service.compensate(rows, **({"tool": {"length_mm": tool}} if tool else {}))
    points = reply["points"]
    np.testing.assert_array_equal(columns(found, ["X", "Y", "Z"]), q)
    expected = [[p["corrected"][a] for a in "XYZ"] for p in points]
    np.testing.assert_allclose(columns(found, [f"{a}_corrected" for a in "XYZ"]), expected, atol=1e-9, rtol=0)
    deviation = [[p["deviation_um"][a] for a in "xyz"] for p in points]
    np.testing.assert_allclose(columns(found, ["dx_um", "dy_um", "dz_um"]), deviation, atol=1e-6, rtol=0)
    assert found["limited"].to_pylist() == [p["limited"] for p in points]
    said = {key.decode(): value.decode() for key, value in found.schema.metadata.items()}
    assert json.loads(said.pop("warnings")) == reply["warnings"]
    assert float(said.pop("reliability")) == reply["reliability"]
    assert said == {key: reply[key] for key in ("machine", "time", "model", "status")}


def test_columns_come_in_any_order_and_batches_of_any_size(service: Service) -> None:
    q = positions(PART + 500, seed=1)
    plain = ask(service, written(table(q)))
    shuffled = ask(service, written(table(q[:0], "ZXY"), table(q, "ZXY"), size=PART + 500))
    assert plain.equals(shuffled)
    empty = ask(service, written(table(q[:0])))
    assert (empty.num_rows, empty.schema) == (0, plain.schema)


def test_a_part_of_a_larger_array_is_read_where_it_lies(service: Service) -> None:
    q = positions(100)
    assert ask(service, written(table(q).slice(13, 20))).equals(ask(service, written(table(q[13:33]))))


def test_it_counts_as_served_and_the_rate_limit_holds(service: Service) -> None:
    content = written(table(positions(50)))
    before = ask(service, content)
    assert not any(before["limited"].to_pylist())
    service.telemetry(sample(NOON + 1.0, 40.0))
    service.clock[0] += 2.0
    moved = ask(service, content)
    assert all(moved["limited"].to_pylist())
    names = [f"{a}_corrected" for a in "XYZ"]
    change = np.abs(columns(moved, names) - columns(before, names)).max()
    assert 0.0 < change <= 2.0e-3 + 1e-9  # two seconds at 60 µm/min
    assert service.state.served is not None
    assert service.state.served.time_s == service.clock[0]
    assert service.state.counts.positions == 100


GOOD = positions(40)
HOLES = pa.table({"X": GOOD[:, 0], "Y": [None, *GOOD[1:, 1]], "Z": GOOD[:, 2]})
INTEGERS = pa.table({"X": GOOD[:, 0], "Y": GOOD[:, 1].astype(int), "Z": GOOD[:, 2]})
TWICE = pa.Table.from_arrays([pa.array(GOOD[:, 0])] * 4, names=["X", "Y", "Z", "X"])


@pytest.mark.parametrize(
    ("content", "detail"),
    [
        (b"", "the body must be an Arrow stream of float64 columns, and its schema cannot be read"),
        (b"{}", "the body must be an Arrow stream of float64 columns, and its schema cannot be read"),
        (written(table(GOOD))[:-600], "the body must be an Arrow stream of float64 columns, and its batch 0 cannot"),
        (written(table(GOOD, "XY")), "the stream must have one float64 column for each of X, Y, Z, got X, Y"),
        (written(TWICE), "the stream must have one float64 column for each of X, Y, Z, got X, Y, Z, X"),
        (written(table(GOOD).append_column("run", [["a"] * 40])), "unknown column 'run' in the stream"),
        (written(INTEGERS), "column 'Y' must be float64, got the format 'l'; cast it"),
        (written(HOLES), "axis 'Y' must be given at every position, got 1 nulls in batch 0"),
        (written(table(positions(MAX_BATCH_POSITIONS + 1)), size=2**30), "a batch must have at most 262144 positions"),
        (
            written(table(positions(2 * MAX_BATCH_POSITIONS)), size=2**30),
            "a batch must have at most 262144 positions, got a longer one; send smaller ones",
        ),
    ],
    ids=["empty", "json", "cut", "missing", "twice", "more", "integers", "nulls", "long", "longer"],
)
def test_what_is_no_such_stream_is_refused_in_a_sentence(service: Service, content: bytes, detail: str) -> None:
    assert_problem(service.client.post(URL, content=content, headers=HEADERS), 422, "invalid-request", detail)
    assert service.state.served is None
    assert service.client.app.state.bulk.taken == 0  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("row", "column", "value", "detail"),
    [
        (3, 1, np.nan, "axis 'Y' must lie within 0 and 500 mm, got nan in position 3"),
        (0, 2, np.inf, "axis 'Z' must lie within 0 and 500 mm, got inf in position 0"),
        (15, 0, 800.5, "axis 'X' must lie within 0 and 800 mm, got 800.5 in position 15"),
    ],
)
def test_a_wrong_first_batch_is_refused(service: Service, row: int, column: int, value: float, detail: str) -> None:
    q = positions(40)
    q[row, column] = value
    answer = service.client.post(URL, content=written(table(q), size=16), headers=HEADERS)
    assert_problem(answer, 422, "invalid-request", detail)


@pytest.mark.parametrize("codec", ["zstd", "lz4"])
def test_a_compressed_batch_is_refused_before_it_is_unpacked(service: Service, codec: str) -> None:
    """A few kilobytes may become gigabytes; so it must be the announcement that is refused, whatever the size."""
    content = written(table(np.ones((200_000, 3))), size=200_000, options=pa.ipc.IpcWriteOptions(compression=codec))
    assert len(content) < 100_000
    answer = service.client.post(URL, content=content, headers=HEADERS)
    assert_problem(answer, 422, "invalid-request", "record batches must not be compressed")


def test_nothing_behind_the_announcement_of_a_compressed_batch_is_read() -> None:
    content = written(table(np.ones((200_000, 3))), size=200_000, options=pa.ipc.IpcWriteOptions(compression="lz4"))
    given = io.BytesIO(content)
    envelope = Envelope(_File(given))
    with pytest.raises(Problem, match="^record batches must not be compressed"):
        _read(envelope)
    assert given.tell() < 2000


def _read(envelope: Envelope) -> None:
    while envelope.readinto(bytearray(8)):
        pass


class _File:
    """A source that reads from memory."""

    failure: Exception | None = None

    def __init__(self, file: io.BytesIO) -> None:
        self._file = file

    def readinto(self, buffer: Any) -> int:
        return self._file.readinto(buffer)

    def expect(self, most: int, what: str) -> None:
        pass


@pytest.mark.parametrize("step", [1, 7, 8, 1000])
def test_an_envelope_passes_a_stream_on_as_it_is(step: int) -> None:
    content = written(table(positions(500)), size=90)
    envelope, read, buffer = Envelope(_File(io.BytesIO(content))), b"", bytearray(step)
    while count := envelope.readinto(buffer):
        read += buffer[:count]
    assert read == content
    assert envelope.failure is None


def test_a_wrong_query_is_refused(service: Service) -> None:
    content = written(table(GOOD))
    for query, detail in (
        ({"tool_length_mm": -1}, "key 'tool_length_mm' in the query"),
        ({"tool": 1}, "unknown key 'tool' in the query"),
        ({"explain": "true"}, "key 'explain' in the query goes with JSON"),
    ):
        assert_problem(
            service.client.post(URL, content=content, headers=HEADERS, params=query), 422, "invalid-request", detail
        )
    answer = service.client.post(URL, json={"positions": [MIDDLE]}, params={"tool_length_mm": 5})
    assert_problem(answer, 422, "invalid-request", "key 'tool_length_mm' in the query goes with Arrow streams")


def test_a_third_stream_is_told_to_come_again(service: Service) -> None:
    places: Any = service.client.app.state.bulk  # type: ignore[attr-defined]
    with places.place(), places.place():
        answer = service.client.post(URL, content=written(table(GOOD)), headers=HEADERS)
        assert_problem(answer, 503, "overloaded", "at most 2 Arrow streams can be open at a time, and are")
        assert answer.headers["retry-after"] == "1"
    assert ask(service, written(table(GOOD))).num_rows == 40


class Given:
    """A source in memory."""

    def __init__(self, content: bytes) -> None:
        self._file = io.BytesIO(content)
        self.failure: Exception | None = None

    def expect(self, most: int, what: str) -> None:
        self._left, self._what = most, what

    def readinto(self, buffer: Any) -> int:
        view = memoryview(buffer).cast("B")
        self._left -= len(view)
        if self._left < 0:
            self.failure = unprocessable(f"a batch must have at most {self._what}")
            raise self.failure
        return self._file.readinto(view)


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=200)
def test_no_changed_stream_is_answered_with_anything_but_numbers_or_a_problem(seed: int) -> None:
    """The reader is compiled code that gets bytes from strangers."""
    rng = np.random.default_rng(seed)
    content = bytearray(written(table(positions(40)), size=16))
    for _ in range(rng.integers(1, 6)):
        content[rng.integers(len(content))] = rng.integers(256)
    if rng.random() < 0.3:
        del content[rng.integers(len(content)) :]
    machine, begin = _machine()
    try:
        answer = b"".join(p.content for p in corrected(Given(bytes(content)), machine, begin))
    except Problem:
        return
    found = pa.ipc.open_stream(answer).read_all()
    q = columns(found, ["X", "Y", "Z"])
    assert ((q >= 0.0) & (q <= [800.0, 500.0, 500.0])).all()
    np.testing.assert_allclose(columns(found, [f"{a}_corrected" for a in "XYZ"]), q, atol=0.3)


def _machine(kept: list[Any] = []) -> Any:  # noqa: B006 (one for all examples)
    if not kept:
        with serving() as service:
            state = service.state
            solver = state.hand_out_solver(None, NOON)[2]
            kept.append((state.machine, lambda: Start(solver, limited=False, said={"machine": "tiny"})))
    return kept[0]


async def _read_all(receive: Any) -> bytes:
    body = Body(receive, asyncio.get_running_loop())
    body.expect(10**6, "bytes")
    buffer = bytearray(1000)
    return bytes(buffer[: await asyncio.to_thread(body.readinto, buffer)])


def test_a_body_is_read_across_its_chunks_and_who_leaves_or_waits_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    def messages(*given: dict[str, Any]) -> Any:
        left = iter(given)

        async def receive() -> dict[str, Any]:
            message = next(left, None)
            if message is None:
                await asyncio.sleep(60)
            return message or {}

        return receive

    def chunk(data: bytes, *, more: bool) -> dict[str, Any]:
        return {"type": "http.request", "body": data, "more_body": more}

    monkeypatch.setattr(body_module, "IDLE_S", 0.05)
    parts = chunk(b"ab", more=True), chunk(b"", more=True), chunk(b"cd", more=False)
    assert asyncio.run(_read_all(messages(*parts))) == b"abcd"
    with pytest.raises(Left):
        asyncio.run(_read_all(messages(chunk(b"ab", more=True), {"type": "http.disconnect"})))
    with pytest.raises(Problem, match="the body must go on within 0.05 s, and nothing came") as late:
        asyncio.run(_read_all(messages(chunk(b"ab", more=True))))
    assert late.value.status == 408

    async def leave() -> None:
        body = Body(messages(), asyncio.get_running_loop())
        body.expect(100, "bytes")
        reading = asyncio.create_task(asyncio.to_thread(body.readinto, bytearray(10)))
        await asyncio.sleep(0.01)
        body.leave()
        with pytest.raises(Left):
            await reading

    monkeypatch.setattr(body_module, "IDLE_S", 60.0)
    asyncio.run(leave())


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[subprocess.Popen[str], str]]:
    process, lines = start(str(TINY), "--port", "0")
    yield process, lines[-1].removeprefix("all calls: http://").removesuffix("/docs")
    process.terminate()
    process.communicate()


def peak_mb(process: subprocess.Popen[str]) -> float:
    status = Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8")
    return int(status.split("VmHWM:")[1].split()[0]) / 1e3


class Upload:
    """A request whose batches are sent one by one, while its answer is read."""

    def __init__(self, address: str) -> None:
        self.connection = http.client.HTTPConnection(address, timeout=60)
        self.connection.putrequest("POST", "/v1/machines/tiny/compensate")
        self.connection.putheader("Content-Type", ARROW)
        self.connection.putheader("Transfer-Encoding", "chunked")
        self.connection.endheaders()

    def send(self, data: bytes) -> None:
        self.connection.send(b"%x\r\n%s\r\n" % (len(data), data))

    def write(self, data: Any) -> int:
        self.send(bytes(data)) if len(data) else None
        return len(data)

    closed = False

    def flush(self) -> None:
        pass

    def __enter__(self) -> "Upload":
        return self

    def __exit__(self, *_: object) -> None:
        if self.reply is not None:
            self.reply.close()
        self.connection.close()

    reply: http.client.HTTPResponse | None = None

    def answer(self) -> http.client.HTTPResponse:
        self.reply = self.connection.getresponse()
        return self.reply


def test_answers_come_while_positions_go_and_memory_stays_bounded(
    served: tuple[subprocess.Popen[str], str],
) -> None:
    """Three million positions are 70 MB in and 220 MB out; the service holds no more than a batch or two of them."""
    process, address = served
    with Upload(address) as upload:
        writer = pa.ipc.new_stream(upload, table(GOOD).schema)
        writer.write_table(table(GOOD))
        reply = upload.answer()  # the request is far from its end
        reader = pa.ipc.open_stream(reply)
        assert reader.read_next_batch().num_rows == 40
        before_mb, batch, batches = peak_mb(process), table(positions(PART)), 45

        def send() -> None:
            for _ in range(batches):
                writer.write_table(batch)
            writer.close()
            upload.send(b"")

        sending = threading.Thread(target=send)
        sending.start()
        time.sleep(1.0)  # nothing is fetched, so nothing more may be taken in
        rows = sum(b.num_rows for b in reader)
        sending.join()
        assert rows == batches * PART
        assert reply.read() == b""  # whole
    assert peak_mb(process) - before_mb < 120.0


def test_a_wrong_batch_later_on_breaks_the_connection_off(served: tuple[subprocess.Popen[str], str]) -> None:
    """The answer has no end, in Arrow's sense and in HTTP's, so nobody takes it for whole."""
    with Upload(served[1]) as upload:
        writer = pa.ipc.new_stream(upload, table(GOOD).schema)
        writer.write_table(table(GOOD))
        reply = upload.answer()
        assert reply.status == 200
        writer.write_table(table(GOOD + 500.0))
        with pytest.raises((http.client.IncompleteRead, ConnectionError)):
            reply.read()


def test_who_leaves_makes_room(served: tuple[subprocess.Popen[str], str]) -> None:
    content = written(table(GOOD))
    for _ in range(4):  # more than there are places
        with Upload(served[1]) as upload:
            upload.send(content[:2000])
    for _ in range(50):
        with Upload(served[1]) as upload:
            upload.send(content)
            upload.send(b"")
            answer = upload.answer()
            data = answer.read()
        if answer.status == 200:
            break
        time.sleep(0.05)
    assert pa.ipc.open_stream(data).read_all().num_rows == 40
