"""Bodies that stop in the middle do not keep the places of others."""

import asyncio
import json
from collections.abc import Iterator
from typing import Any

import pytest
from service_client import MIDDLE, Service, serving
from starlette.types import Message

from service import body_limit

BODY = json.dumps({"positions": [MIDDLE]}).encode()


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Iterator[Service]:
    monkeypatch.setattr(body_limit, "BODY_S", 0.1)
    with serving(max_in_work=1) as found:
        yield found


async def ask(app: Any, *parts: bytes, pause_s: float = 0.0, path: str = "compensate") -> tuple[int, dict[str, Any]]:
    """Call the app with a body in parts, the last of which does not say that it is the last."""
    waiting = list(parts)
    answered: list[Message] = []

    async def receive() -> Message:
        if not waiting:
            await asyncio.Event().wait()
        await asyncio.sleep(pause_s)
        return {"type": "http.request", "body": waiting.pop(0), "more_body": bool(waiting) or parts[-1] == b""}

    async def send(message: Message) -> None:
        answered.append(message)

    scope = {
        "type": "http",
        "method": "POST",
        "path": f"/v1/machines/tiny/{path}",
        "raw_path": b"",
        "query_string": b"",
        "root_path": "",
        "scheme": "http",
        "server": ("127.0.0.1", 8000),
        "client": ("127.0.0.1", 1),
        "headers": [(b"content-type", b"application/json")],
        "state": {},
    }
    await app(scope, receive, send)
    return answered[0]["status"], json.loads(answered[1]["body"])


@pytest.mark.parametrize("path", ["compensate", "telemetry"])
@pytest.mark.parametrize("parts", [(b"",), (b"{", b""), (BODY, b"")])
def test_a_body_that_stops_is_answered_and_leaves_its_place(
    service: Service, parts: tuple[bytes, ...], path: str
) -> None:
    async def run() -> None:
        status, body = await asyncio.wait_for(ask(service.client.app, *parts, path=path), 5.0)
        assert (status, body["type"]) == (408, "urn:thermotrue:problem:request-timeout")
        assert body["detail"].startswith("the body must be there within 0.1 s, and was not")
        assert (await ask(service.client.app, BODY))[0] == 200  # its place, of one, is free

    asyncio.run(run())


def test_parts_that_keep_coming_do_not_give_more_time(service: Service) -> None:
    async def run() -> None:
        parts = [b" "] * 100 + [b""]
        status, _ = await asyncio.wait_for(ask(service.client.app, *parts, pause_s=0.02), 1.5)
        assert status == 408

    asyncio.run(run())


def test_a_body_in_time_in_parts_is_read_whole(service: Service) -> None:
    status, body = asyncio.run(ask(service.client.app, BODY[:5], BODY[5:20], BODY[20:], pause_s=0.005))
    assert (status, len(body["points"])) == (200, 1)
