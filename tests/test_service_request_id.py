"""Every answer has a request id and security headers, and log lines and problems name the same id."""

import asyncio
import json
import logging
import re
from typing import Any

import pytest
from service_client import MIDDLE, NOON, TINY_URL, Service, assert_problem, sample

from service.logs import JsonLines
from service.request_id import RequestIds, current
from service.security_headers import API_POLICY, DOCS_POLICY

MADE = re.compile(r"[0-9a-f]{32}")


@pytest.mark.parametrize("given", ["a", "7d2f-4e", "Root=1-67891233-abcdef012345", "a" * 128, "x/y:z.w_v+u@t"])
def test_a_well_formed_id_is_taken_over(service: Service, given: str) -> None:
    answer = service.client.get("/healthz", headers={"X-Request-ID": given})
    assert answer.headers.get_list("x-request-id") == [given]
    answer = service.client.get("/nowhere", headers={"x-request-id": given})
    assert answer.json()["request_id"] == given


@pytest.mark.parametrize("given", [None, "", " ", "a b", "a" * 129, 'a"b', "a\tb", "é".encode(), b"a;b", "a,b"])
def test_otherwise_one_is_made(service: Service, given: Any) -> None:
    headers = {} if given is None else {"X-Request-ID": given}
    made = [service.client.get("/healthz", headers=headers).headers["x-request-id"] for _ in range(3)]
    assert all(MADE.fullmatch(m) for m in made)
    assert len(set(made)) == 3


def test_every_kind_of_answer_has_one(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    service.warm()
    tag = service.client.get(f"{TINY_URL}/map").headers["etag"]
    calls = [
        ("GET", "/readyz", {}, 200),
        ("GET", "/docs", {}, 200),
        ("GET", "/docs/assets/swagger-ui.css", {}, 200),
        ("GET", "/openapi.json", {}, 200),
        ("GET", "/metrics", {}, 200),
        ("POST", f"{TINY_URL}/compensate", {"json": {"positions": [MIDDLE]}}, 200),
        ("GET", f"{TINY_URL}/map", {"headers": {"if-none-match": tag}}, 304),
        ("POST", f"{TINY_URL}/compensate", {"content": b"{", "headers": {"content-type": "application/json"}}, 400),
        ("GET", "/nowhere", {}, 404),
        ("PATCH", TINY_URL, {}, 405),
        ("POST", f"{TINY_URL}/compensate", {"content": b" " * 9_000_000}, 413),
        ("POST", f"{TINY_URL}/compensate", {"json": {}}, 422),
    ]
    answers = []
    for method, path, more, status in calls:
        answer = service.client.request(method, path, **more)
        assert answer.status_code == status, (path, answer.text)
        answers.append(answer)
    monkeypatch.setattr(service.state, "outlook", lambda now_s: 1 / 0)
    answers.append(service.client.get(TINY_URL))
    assert_problem(answers[-1], 500, "internal")
    for answer in answers:
        assert MADE.fullmatch(answer.headers["x-request-id"]), answer.url
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert "frame-ancestors 'none'" in answer.headers["content-security-policy"]
        documentation = answer.request.url.path.startswith("/docs")
        assert answer.headers["content-security-policy"] == (DOCS_POLICY if documentation else API_POLICY)
        if documentation:
            assert answer.headers["cache-control"] == "no-cache"
        elif answer.status_code == 304:
            assert answer.headers["cache-control"] == "private, no-cache"
        else:
            assert answer.headers["cache-control"] == "no-store"
        if answer.status_code >= 400:
            assert_problem(answer, answer.status_code, answer.json()["type"].rsplit(":", 1)[1])
    assert len({a.headers["x-request-id"] for a in answers}) == len(answers)


class Lines(logging.Handler):
    """Formats as the service does, at the moment when it does."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[dict[str, Any]] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(json.loads(JsonLines().format(record)))


def test_log_lines_name_the_request_they_belong_to(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    handler = Lines()
    logger = logging.getLogger("service")
    logger.addHandler(handler)
    monkeypatch.setattr(logger, "level", logging.INFO)
    try:
        for number in (1, 2):
            body = {"samples": [sample(NOON + number, column=None if number == 1 else 20.0)]}
            service.client.post(f"{TINY_URL}/telemetry", json=body, headers={"x-request-id": f"call-{number}"})
        logger.info("outside")
    finally:
        logger.removeHandler(handler)
    assert [(line["event"], line.get("request_id")) for line in handler.lines] == [
        ("sensor replaced", "call-1"),
        ("sensor back", "call-2"),
        ("outside", None),
    ]
    assert current() is None


def test_the_server_can_still_tell_the_id_of_a_request_that_failed() -> None:
    async def broken(scope: Any, receive: Any, send: Any) -> None:
        raise ZeroDivisionError

    async def serve() -> str | None:
        scope = {"type": "http", "headers": [(b"x-request-id", b"call-9")]}
        with pytest.raises(ZeroDivisionError):
            await RequestIds(broken)(scope, None, None)  # type: ignore[arg-type]
        return current()

    assert asyncio.run(serve()) == "call-9"
    assert current() is None


def test_the_docs_page_needs_no_more_than_its_policy_allows(service: Service) -> None:
    page = service.client.get("/docs").text
    sources = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert sources
    assert all(source.startswith("/docs/assets/") for source in sources)


def test_the_description_tells_of_the_id(service: Service) -> None:
    described = service.client.get("/openapi.json").json()
    assert "X-Request-ID" in described["info"]["description"]
    for methods in described["paths"].values():
        for operation in methods.values():
            assert "X-Request-ID" in operation["responses"]["default"]["headers"]
