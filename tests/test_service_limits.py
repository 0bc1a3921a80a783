"""Too many requests, and more work than there is time for."""

import asyncio
import json
import signal
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from service_client import MIDDLE, TINY, assert_problem, sample, serving
from sqlalchemy import create_engine, func, select
from starlette.types import Message, Scope
from test_service_process import start

from service.access.roles import Caller, Role
from service.overload import Overload, Turns
from service.rate_limit import MAX_BUCKETS, RateLimit
from service.store.tables import telemetry


async def nothing(*args: Any) -> None:
    """Stand for an app that answers at once."""


@given(
    per_s=st.floats(0.5, 1000.0),
    pauses=st.lists(st.floats(0.0, 2.0), min_size=1, max_size=300),
)
def test_no_caller_gets_more_than_the_rate_and_one_second_of_it(per_s: float, pauses: list[float]) -> None:
    clock = [0.0]
    limit = RateLimit(nothing, per_s, lambda: clock[0])
    burst = max(per_s, 1.0)
    taken = 0
    for pause in pauses:
        clock[0] += pause
        wait_s = limit.take("somebody")
        taken += wait_s == 0
        assert taken <= burst + per_s * clock[0] + 1e-5
        if wait_s > 0:
            clock[0] += wait_s * (1 + 1e-9)
            assert limit.take("somebody") == 0  # what it said to wait is enough
            taken += 1


def test_one_callers_haste_does_not_slow_another() -> None:
    clock = [0.0]
    limit = RateLimit(nothing, 10.0, lambda: clock[0])
    assert [limit.take("a") for _ in range(10)] == [0] * 10
    assert limit.take("a") == pytest.approx(0.1)
    assert limit.take("b") == 0


def test_many_addresses_do_not_fill_the_memory_nor_free_who_is_over_the_limit() -> None:
    clock = [0.0]
    limit = RateLimit(nothing, 10.0, lambda: clock[0])
    for number in range(MAX_BUCKETS + 100):
        limit.take(f"at {number}")
        if number > MAX_BUCKETS - 20:
            limit.take("the busy one")
    assert len(limit._buckets) <= MAX_BUCKETS
    assert limit.take("the busy one") > 0


def test_too_many_requests_say_how_long_to_wait() -> None:
    with serving(max_requests_per_s=0.01) as service:
        assert service.client.get("/v1/machines").status_code == 200
        answer = service.client.get("/v1/machines")
        assert_problem(answer, 429, "too-many-requests", "one caller may make 0.01 requests a second, got more; wait")
        assert 1 <= int(answer.headers["retry-after"]) <= 100
        assert service.client.get("/healthz").status_code == 200


def test_no_rate_limit_where_it_is_zero() -> None:
    with serving(max_requests_per_s=0) as service:
        assert {service.client.get("/v1/machines").status_code for _ in range(50)} == {200}


class Answers:
    """Runs requests through the middleware, and notes what became of them and in which order."""

    def __init__(self, most: int = 4, most_first: int = 4) -> None:
        self.worked: list[str] = []
        self.refused: list[str] = []
        self.together, self._now = 0, 0
        self.hold: asyncio.Event | None = None
        self.overload = Overload(self._app, most, most_first, Turns())

    async def _app(self, scope: Scope, receive: Any, send: Any) -> None:
        self._now += 1
        self.together = max(self.together, self._now)
        if self.hold is not None:
            await self.hold.wait()
        self.worked.append(scope["name"])
        self._now -= 1

    async def ask(self, name: str, path: str = "/v1/machines/m/compensate") -> None:
        async def send(message: Message) -> None:
            if message["type"] == "http.response.start":
                assert message["status"] == 503
                assert (b"retry-after", b"1") in message["headers"]
                self.refused.append(name)

        state = {"caller": Caller("a", Role.ADMIN)}
        await self.overload({"type": "http", "path": path, "name": name, "state": state}, nothing, send)  # type: ignore[arg-type]


@given(st.lists(st.integers(1, 12), min_size=1, max_size=20))
def test_what_is_let_through_goes_in_the_order_in_which_it_came(bursts: list[int]) -> None:
    async def run() -> Answers:
        answers = Answers(most=6)
        tasks, number = [], 0
        for burst in bursts:
            for _ in range(burst):
                tasks.append(asyncio.create_task(answers.ask(f"{number:03}")))
                number += 1
            await asyncio.sleep(0)
        await asyncio.wait_for(asyncio.gather(*tasks), 5)
        await answers.ask("last")  # nothing is left in work
        return answers

    answers = asyncio.run(run())
    assert answers.worked == sorted(answers.worked)
    assert len(answers.worked) + len(answers.refused) == sum(bursts) + 1
    assert answers.worked[-1] == "last"
    if max(bursts) <= 1:
        assert not answers.refused


def test_telemetry_goes_before_all_that_waits_for_its_turn() -> None:
    async def run() -> Answers:
        answers = Answers(most=100)
        waiting = [asyncio.create_task(answers.ask(f"compensate {i}")) for i in range(50)]
        await asyncio.sleep(0)
        telemetry = asyncio.create_task(answers.ask("telemetry", "/v1/machines/m/telemetry"))
        await asyncio.gather(telemetry, *waiting)
        return answers

    answers = asyncio.run(run())
    assert not answers.refused
    assert answers.worked.index("telemetry") <= 2


def test_each_kind_has_its_own_bound_and_metrics_have_none() -> None:
    async def run() -> Answers:
        answers = Answers(most=2, most_first=3)
        answers.hold = asyncio.Event()
        tasks = [asyncio.create_task(answers.ask(f"c{i}")) for i in range(4)]
        tasks += [asyncio.create_task(answers.ask(f"t{i}", "/v1/machines/m/telemetry")) for i in range(5)]
        tasks += [asyncio.create_task(answers.ask(f"m{i}", "/metrics")) for i in range(5)]
        for _ in range(20):
            await asyncio.sleep(0)
        answers.hold.set()
        await asyncio.gather(*tasks)
        return answers

    answers = asyncio.run(run())
    assert sorted(answers.refused) == ["c2", "c3", "t3", "t4"]


def test_who_leaves_while_waiting_does_not_hold_up_the_rest() -> None:
    async def run() -> Answers:
        answers = Answers(most=10)
        tasks = [asyncio.create_task(answers.ask(f"{i}")) for i in range(10)]
        await asyncio.sleep(0)
        for task in tasks[1:9]:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await asyncio.wait_for(answers.ask("next"), 1)
        return answers

    answers = asyncio.run(run())
    assert answers.worked == ["0", "9", "next"]


class Client:
    """Connections to a service that are kept, and requests in HTTP/1.1 by hand, which costs this side little."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._idle: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = []

    async def post(self, path: str, body: bytes) -> tuple[int, dict[bytes, bytes], bytes]:
        reader, writer = self._idle.pop() if self._idle else await asyncio.open_connection("127.0.0.1", self._port)
        head = (
            f"POST {path} HTTP/1.1\r\nhost: x\r\ncontent-type: application/json\r\ncontent-length: {len(body)}\r\n\r\n"
        )
        writer.write(head.encode() + body)
        lines = (await reader.readuntil(b"\r\n\r\n")).split(b"\r\n")
        headers = dict(line.split(b": ", 1) for line in lines[1:] if line)
        content = await reader.readexactly(int(headers[b"content-length"]))
        self._idle.append((reader, writer))
        return int(lines[0].split()[1]), headers, content

    async def close(self) -> None:
        for _, writer in self._idle:
            writer.close()
            await writer.wait_closed()


CLIENTS, IN_WORK = 300, 16
PAUSE_S = 0.2
"""After a refusal; a client that does as it is told waits for a second."""
SECONDS = 3.0
ASKED = "/v1/machines/tiny/compensate?explain=true"
HEAVY = json.dumps({"positions": [MIDDLE] * 100}).encode()


async def load(port: int) -> tuple[float, Counter[int], list[Any], int]:
    """Ask for far more than can be answered, send telemetry all the while, and return what came back."""
    client = Client(port)
    await client.post(ASKED, HEAVY)
    began_s, answered = time.perf_counter(), 0
    while time.perf_counter() - began_s < 0.5:
        await client.post(ASKED, HEAVY)
        answered += 1
    capacity = answered / (time.perf_counter() - began_s)
    statuses: Counter[int] = Counter()
    wrong: list[Any] = []
    stored = 0
    end_s = time.perf_counter() + SECONDS

    async def ask() -> None:
        while time.perf_counter() < end_s:
            status, headers, content = await client.post(ASKED, HEAVY)
            statuses[status] += 1
            if status == 503:
                if headers.get(b"retry-after") != b"1" or b"urn:thermotrue:problem:overloaded" not in content:
                    wrong.append((status, headers, content))
                await asyncio.sleep(PAUSE_S)
            elif status != 200:
                wrong.append((status, content))

    async def tell() -> None:
        nonlocal stored
        while time.perf_counter() < end_s:
            body = json.dumps({"samples": [sample(time.time(), 20.0)]}).encode()
            status, _, content = await client.post("/v1/machines/tiny/telemetry", body)
            if status != 200 or json.loads(content)["accepted"] != 1:
                wrong.append((status, content))
            stored += 1
            await asyncio.sleep(0.02)

    await asyncio.gather(tell(), *(ask() for _ in range(CLIENTS)))
    await client.close()
    return capacity, statuses, wrong, stored


def test_at_ten_times_its_capacity_the_service_says_so_and_keeps_all_telemetry(tmp_path: Path) -> None:
    database = f"sqlite:///{tmp_path / 'a.db'}"
    process, lines = start(str(TINY), "--port", "0", "--database", database, "--max-in-work", str(IN_WORK))
    try:
        port = int(lines[-1].removesuffix("/docs").rsplit(":", 1)[1])
        capacity, statuses, wrong, stored = asyncio.run(load(port))
    finally:
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=20)
    print(capacity, statuses, stored)
    assert not wrong, wrong[:3]
    assert set(statuses) == {200, 503}
    assert statuses.total() > 10 * statuses[200]
    assert statuses[200] > 0.1 * capacity * SECONDS  # refusing does not eat up the time for answering
    assert stored > 2
    engine = create_engine(database)
    with engine.connect() as connection:
        assert connection.execute(select(func.count()).select_from(telemetry)).scalar() == stored
    engine.dispose()
    assert process.returncode == 0
    assert "Traceback" not in errors
