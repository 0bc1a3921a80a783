"""The stream: what `compensate` answers, message by message, in JSON or as numbers; wrong messages do not end it."""

import asyncio
import json
import re
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import websockets
from hypothesis import given, settings
from hypothesis import strategies as st
from service_client import MIDDLE, NOON, TINY, Service, sample, serving
from starlette.testclient import WebSocketTestSession
from starlette.websockets import WebSocketDisconnect
from test_service_process import start

from service.routes import stream as stream_route
from service.schemas import MAX_POSITIONS_PER_REQUEST
from service.stream.arrow import MAX_BATCH_POSITIONS
from service.stream.session import HEAD, MAX_ID, STATUSES, Session
from service.stream.streams import BROKEN, GOING_AWAY, MAX_STREAMS, SLOW, Streams

STREAM = "/v1/machines/tiny/stream"


@pytest.fixture
def service() -> Iterator[Service]:
    with serving() as service:
        service.warm(degC=26.0)
        yield service


def open_stream(service: Service, path: str = STREAM) -> WebSocketTestSession:
    return service.client.websocket_connect(path)


def ask(stream: WebSocketTestSession, **message: Any) -> dict[str, Any]:
    stream.send_text(json.dumps(message))
    reply: dict[str, Any] = json.loads(stream.receive_text())
    return reply


def ask_binary(stream: WebSocketTestSession, q: Any) -> tuple[tuple[Any, ...], np.ndarray[Any, Any]]:
    q = np.asarray(q, dtype="<f8")
    stream.send_bytes(q.tobytes())
    reply = stream.receive_bytes()
    return HEAD.unpack_from(reply), np.frombuffer(reply, "<f8", offset=HEAD.size).reshape(q.shape)


def test_a_message_is_answered_as_a_request_is(service: Service) -> None:
    positions = [MIDDLE, MIDDLE | {"X": 10.0}]
    with open_stream(service) as stream:
        for number, tool in enumerate((None, {"length_mm": 180.0})):
            reply = ask(stream, id=number, positions=positions, **({"tool": tool} if tool else {}))
            assert reply.pop("id") == number
            assert reply == service.compensate(positions, **({"tool": tool} if tool else {}))


def test_numbers_are_those_of_json(service: Service) -> None:
    rng = np.random.default_rng(1)
    q = rng.uniform(0.0, 500.0, (50, 3))
    positions = [dict(zip("XYZ", row, strict=True)) for row in q.tolist()]
    with open_stream(service) as stream:
        said = ask(stream, id="s", format="binary", tool={"length_mm": 60.0})
        assert (said["id"], said["axes"], said["statuses"]) == ("s", ["X", "Y", "Z"], list(STATUSES))
        (count, status, flags, _, time_s), corrected = ask_binary(stream, q)
        reply = ask(stream, positions=positions)  # with the tool that was set
    assert (count, STATUSES[status], flags, time_s) == (50, "ok", 0, NOON)
    np.testing.assert_array_equal(corrected, [[p["corrected"][a] for a in "XYZ"] for p in reply["points"]])
    assert reply["points"] == service.compensate(positions, tool={"length_mm": 60.0})["points"]


def test_flags_say_what_is_limited_and_that_there_are_warnings(service: Service) -> None:
    with open_stream(service) as stream:
        ask(stream, format="binary")
        (_, _, before, _, _), settled = ask_binary(stream, [[400.0, 250.0, 250.0]])
        service.telemetry(sample(NOON + 1.0, 26.5))  # the correction cannot be there at once
        (_, _, after, _, _), moved = ask_binary(stream, [[400.0, 250.0, 250.0]])
        assert (before, after) == (0, 3)
        np.testing.assert_allclose(moved, settled, atol=1e-6)


def test_a_stream_moves_no_faster_than_the_rate_limit(service: Service) -> None:
    """What is asked through the stream and what is asked by requests share one served map."""
    q = np.array([[400.0, 250.0, 250.0]])
    with open_stream(service) as stream:
        ask(stream, format="binary")
        last = ask_binary(stream, q)[1]
        for step in range(1, 40):
            service.clock[0] += 0.5
            if step % 10 == 1:
                service.telemetry(sample(service.clock[0], 26.0 + (-1) ** step * step))
            if step % 7 == 0:
                service.compensate()
            corrected = ask_binary(stream, q)[1]
            assert np.abs(corrected - last).max() <= 0.5e-3 * 60.0 / 60.0 + 1e-9  # half a second at 60 µm/min
            last = corrected


WRONG: list[tuple[str | bytes, str]] = [
    ("{", "a text message must be JSON, got text that is not: "),
    ("[]", "a text message must be a JSON object, got something else"),
    ("{}", "a message must have 'positions', or 'format' and 'tool' as settings, got none of them"),
    ('{"positions": []}', "key 'positions' in the message"),
    ('{"positions": [{"X": 1}]}', "axis 'Y' must be given in positions[0], got X; give all axes [mm]"),
    ('{"positions": [{"X": 1, "Y": 1, "Z": 501}]}', "axis 'Z' must lie within 0 and 500 mm, got 501 in positions[0]"),
    ('{"positions": [{"X": 1, "Y": 1, "Z": NaN}]}', "key 'positions.0.Z' in the message"),
    ('{"posittions": []}', "unknown key 'posittions' in the message; did you mean 'positions'?"),
    ('{"format": "hex"}', "key 'format' in the message"),
    ('{"format": "json", "positions": [{"X": 1, "Y": 1, "Z": 1}]}', "key 'format' must come without 'positions'"),
    (b"\0" * 24, "binary messages must be announced, got one before that"),
]


@pytest.mark.parametrize(("message", "detail"), WRONG)
def test_a_wrong_message_gets_a_problem_and_the_stream_goes_on(
    service: Service, message: str | bytes, detail: str
) -> None:
    with open_stream(service) as stream:
        stream.send_text(message) if isinstance(message, str) else stream.send_bytes(message)
        problem = json.loads(stream.receive_text())
        assert problem["detail"].startswith(detail), problem["detail"]
        assert (problem["status"], problem["type"]) == (422, "urn:thermotrue:problem:invalid-request")
        assert problem["instance"] == STREAM
        assert problem["request_id"]
        assert ask(stream, positions=[MIDDLE])["status"] == "ok"


@pytest.mark.parametrize(
    ("data", "detail"),
    [
        (b"", "a binary message must hold 1 to 2000 positions of 24 bytes, float64 for each of X, Y, Z, got 0 bytes"),
        (b"\0" * 25, "a binary message must hold 1 to 2000 positions"),
        (b"\0" * 24 * (MAX_POSITIONS_PER_REQUEST + 1), "a binary message must hold 1 to 2000 positions"),
        (struct.pack("<3d", 1, 1, np.nan), "axis 'Z' must lie within 0 and 500 mm, got nan in position 0"),
        (struct.pack("<6d", 1, 1, 1, 1, -np.inf, 1), "axis 'Y' must lie within 0 and 500 mm, got -inf in position 1"),
        (struct.pack("<3d", 1e9, 1, 1), "axis 'X' must lie within 0 and 800 mm, got 1000000000 in position 0"),
    ],
)
def test_wrong_numbers_get_a_problem_in_a_sentence(service: Service, data: bytes, detail: str) -> None:
    with open_stream(service) as stream:
        ask(stream, format="binary")
        served = service.state.served
        stream.send_bytes(data)
        assert json.loads(stream.receive_text())["detail"].startswith(detail)
        assert service.state.served is served  # nothing was handed out
        assert ask_binary(stream, [[1.0, 1.0, 1.0]])[0][0] == 1


@pytest.mark.parametrize("text", ['{"id": 7, "positions": 1}', '{"id": "a", "format": 1}'])
def test_a_problem_carries_the_id_of_its_message(service: Service, text: str) -> None:
    with open_stream(service) as stream:
        stream.send_text(text)
        assert json.loads(stream.receive_text())["id"] == json.loads(text)["id"]


@given(
    message=st.one_of(
        st.text(), st.binary(), st.recursive(st.none() | st.floats() | st.text(), st.lists).map(json.dumps)
    )
)
@settings(max_examples=150, deadline=None)
def test_any_message_is_answered(message: str | bytes) -> None:
    """With a reply or a problem: no message ends a stream."""
    session = Session(_state(), STREAM)
    session.binary = True
    try:
        session.answer(message)
    except Exception as problem:
        said = json.loads(session.refusal(message, problem))
        assert said["status"] == 422, said


def _state(kept: list[Any] = []) -> Any:  # noqa: B006 (one for all examples)
    if not kept:
        with serving() as service:
            kept.append(service.state)
    return kept[0]


def test_an_unknown_machine_is_refused_before_the_stream_opens(service: Service) -> None:
    with pytest.raises(WebSocketDisconnect) as refused, open_stream(service, "/v1/machines/tiny2/stream"):
        pass
    assert refused.value.status_code == 404  # type: ignore[attr-defined]
    assert "did you mean 'tiny'?" in refused.value.json()["detail"]  # type: ignore[attr-defined]


def test_too_many_streams_are_refused_and_a_closed_one_makes_room(service: Service) -> None:
    app: Any = service.client.app
    app.state.streams = Streams(most=1)
    with open_stream(service):
        with pytest.raises(WebSocketDisconnect) as refused, open_stream(service):
            pass
        assert refused.value.status_code == 503  # type: ignore[attr-defined]
        assert refused.value.headers["retry-after"] == "1"  # type: ignore[attr-defined]
    with open_stream(service) as stream:
        assert ask(stream, positions=[MIDDLE])["status"] == "ok"


def test_what_nobody_expected_ends_the_stream_with_a_problem(
    service: Service, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(service.state, "compensate", lambda *_: 1 / 0)
    with open_stream(service) as stream:
        assert ask(stream, positions=[MIDDLE])["type"] == "urn:thermotrue:problem:internal"
        with pytest.raises(WebSocketDisconnect) as ended:
            stream.receive_text()
    assert ended.value.code == 1011
    assert "stream failed" in caplog.text


@pytest.fixture(scope="module")
def page_server() -> Iterator[str]:
    process, lines = start(str(TINY), "--port", "0")
    yield lines[-1].removeprefix("all calls: http://").removesuffix("/docs")
    process.terminate()
    process.communicate()


@pytest.fixture
def served() -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A real process: what the server does with connections shows nowhere else."""
    process, lines = start(str(TINY), "--port", "0")
    address = lines[-1].removeprefix("all calls: http").removesuffix("/docs")
    yield process, f"ws{address}{STREAM}"
    process.kill()
    process.communicate()


def test_a_stream_ends_with_going_away_when_the_service_stops(served: tuple[subprocess.Popen[str], str]) -> None:
    process, url = served

    async def talk() -> tuple[int, int, str]:
        async with websockets.connect(url) as stream:
            for number in range(3):
                await stream.send(json.dumps({"id": number, "positions": [MIDDLE]}))
                assert json.loads(await stream.recv())["id"] == number
            process.terminate()
            with pytest.raises(websockets.ConnectionClosed) as ended:
                await stream.recv()
            assert ended.value.rcvd is not None
            return ended.value.rcvd.code, await asyncio.to_thread(process.wait, 10), ended.value.rcvd.reason

    assert asyncio.run(talk()) == (1001, 0, "the service stops; connect again")


def test_replies_come_in_order_and_a_long_message_ends_the_stream(served: tuple[subprocess.Popen[str], str]) -> None:
    """Many messages at once wait in the connection; one beyond the limit is not read."""

    async def talk() -> int:
        async with websockets.connect(served[1]) as stream:
            for number in range(200):
                await stream.send(json.dumps({"id": number, "positions": [MIDDLE] * 20}))
            got = [json.loads(await stream.recv())["id"] for _ in range(200)]
            assert got == list(range(200))
            await stream.send(" " * (2**20 + 1))
            with pytest.raises(websockets.ConnectionClosed) as ended:
                await stream.recv()
            assert ended.value.rcvd is not None
            return ended.value.rcvd.code

    assert asyncio.run(talk()) == 1009


def test_who_does_not_fetch_replies_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reply waits for room that never comes; the stream is closed with a code, and its place is free."""
    monkeypatch.setattr(stream_route, "SLOW_READER_S", 0.05)

    class Stuck:
        application_state = stream_route.end.__globals__["WebSocketState"].CONNECTED
        closed: tuple[int, str] | None = None

        async def send(self, message: Any) -> None:
            await asyncio.sleep(60)

        async def close(self, code: int, reason: str) -> None:
            self.closed = code, reason

    stuck: Any = Stuck()
    assert asyncio.run(stream_route._send(stuck, "reply")) is False
    assert stuck.closed == (1008, "replies must be fetched within 0.05 s")


PAGE = (Path(__file__).parents[1] / "docs" / "service-streams.md").read_text(encoding="utf-8")


def test_the_page_says_what_is_true() -> None:
    """Codes, the head's layout and the limits, as the page gives them."""
    codes = (GOING_AWAY, SLOW, BROKEN)
    most = (MAX_POSITIONS_PER_REQUEST, MAX_BATCH_POSITIONS)
    facts = [f"`{HEAD.format}`", *(f"| {c} |" for c in codes), *(f"{n:,}".replace(",", " ") for n in most)]
    facts += [f"{stream_route.SLOW_READER_S:g} s", f"{MAX_STREAMS} streams", f"{MAX_ID} characters"]
    for fact in facts:
        assert fact in PAGE, fact


@pytest.mark.parametrize("block", re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL), ids=["json", "binary", "arrow"])
def test_the_clients_on_the_page_run(page_server: str, block: str) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", f"address, name = {page_server!r}, 'tiny'\n{block}"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "geometric_only" in done.stdout
