"""The short way and the framework's: the same answers, the same problems, and nobody gets through who should not."""

import asyncio
import json
from typing import Any

import pytest
from service_client import MIDDLE, NOON, TINY_URL, Service, sample
from starlette.types import Message, Scope

from service import fast_lane
from service.access.roles import Caller, Role
from service.schemas import CompensateReply

URL = f"{TINY_URL}/compensate"
BODIES: list[Any] = [
    {"positions": [MIDDLE]},
    {"positions": [MIDDLE, MIDDLE | {"Z": 1}], "tool": {"length_mm": 80}},
    {"positions": [MIDDLE], "time": NOON},
    {"positions": [MIDDLE], "time": NOON + 1e6},
    {"positions": [MIDDLE | {"X": 801}]},
    {"positions": [MIDDLE | {"W": 1}]},
    {"positions": [{"X": "1", "Y": 1, "Z": 1}]},
    {"positions": []},
    {"positions": [MIDDLE], "channels": {"spindle_rpm": 1.0}},
    {"positions": [MIDDLE], "tool": {"length_mm": -1}},
    [],
    None,
]


@pytest.fixture
def lanes(service: Service, monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Whether each request was answered the short way."""
    taken: list[bool] = []
    answer = fast_lane._answer

    def watched(*given: Any) -> bytes | None:
        content = answer(*given)
        taken.append(content is not None)
        return content

    monkeypatch.setattr(fast_lane, "_answer", watched)
    return taken


@pytest.mark.parametrize("body", BODIES, ids=range(len(BODIES)))
def test_both_ways_answer_the_same(service: Service, lanes: list[bool], body: Any) -> None:
    """A query, even one that asks for nothing, takes the framework's way."""
    service.warm(degC=26.0)
    content, headers = json.dumps(body), {"content-type": "application/json"}
    short = service.client.post(URL, content=content, headers=headers)
    asked = len(lanes)
    other = service.client.post(URL, params={"explain": "false"}, content=content, headers=headers)
    assert len(lanes) == asked == 1
    assert lanes == [short.status_code == 200]
    assert short.status_code == other.status_code
    one, two = short.json(), other.json()
    if short.status_code == 200:
        CompensateReply.model_validate(one, strict=False)
    else:
        assert one.pop("request_id") != two.pop("request_id")
    assert one == two
    ours = {key for key in short.headers if key != "content-length"}
    assert ours == {key for key in other.headers if key != "content-length"}


def test_a_sample_that_comes_along_takes_the_other_way(service: Service, lanes: list[bool]) -> None:
    service.warm(degC=26.0, end=NOON - 60.0)
    service.compensate(time=NOON, temperatures=sample(NOON)["temperatures"])
    assert lanes == [False]


def test_a_body_in_pieces_is_put_together_and_handed_on(service: Service, lanes: list[bool]) -> None:
    for body, status in ((json.dumps({"positions": [MIDDLE]}), 200), ('{"positions": 5}', 422)):
        pieces = (body[i : i + 7].encode() for i in range(0, len(body), 7))
        answer = service.client.post(URL, content=pieces, headers={"content-type": "application/json"})
        assert answer.status_code == status, answer.text
    assert lanes == [True, False]


def test_too_long_a_body_is_refused_as_elsewhere(service: Service) -> None:
    answer = service.client.post(URL, content=b" " * (9 * 2**20), headers={"content-type": "application/json"})
    assert answer.status_code == 413


def test_it_counts_in_the_metrics_of_its_route(service: Service, lanes: list[bool]) -> None:
    service.compensate()
    assert lanes == [True]
    text = service.client.get("/metrics").text
    labels = '{method="POST",route="/v1/machines/{name}/compensate",status="200"}'
    assert f"thermotrue_request_seconds_count{labels} 1.0" in text


@pytest.mark.parametrize(
    ("change", "passes"),
    [
        ({}, True),
        ({"method": "GET"}, False),
        ({"query_string": b"a=b"}, False),
        ({"path": "/v1/machines/other/compensate"}, False),
        ({"path": "/v1/machines/tiny/compensate/"}, False),
        ({"headers": [(b"content-type", b"text/plain")]}, False),
        ({"state": {"caller": Caller("a", Role.VIEWER)}}, False),
        ({"state": {"caller": Caller("a", Role.ADMIN)}}, True),
    ],
)
def test_only_plain_requests_of_gateways_take_it(service: Service, change: dict[str, Any], *, passes: bool) -> None:
    scope: Scope = {
        "type": "http",
        "method": "POST",
        "path": URL,
        "query_string": b"",
        "headers": [(b"content-type", b"application/json")],
        "state": {"caller": Caller("a", Role.GATEWAY)},
        "app": service.client.app,
    } | change
    passed_on, sent = [], []

    async def inner(*_: Any) -> None:
        passed_on.append(True)

    async def receive() -> Message:
        return {"type": "http.request", "body": json.dumps({"positions": [MIDDLE]}).encode()}

    async def send(message: Message) -> None:
        sent.append(message["type"])

    lane = fast_lane.FastLane(inner, route=None)  # type: ignore[arg-type]
    asyncio.run(lane(scope, receive, send))
    assert (bool(sent), bool(passed_on)) == (passes, not passes)
