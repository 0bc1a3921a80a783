"""Nobody comes in uninvited: every route without a key, with a wrong one, and with a key of each role."""

import asyncio
import base64
import hmac
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.routing import iter_route_contexts
from fastapi.testclient import TestClient
from service_client import MIDDLE, NOON, TINY, TINY_URL, assert_problem
from sqlalchemy import select
from sqlalchemy.exc import OperationalError
from starlette.routing import Mount
from starlette.testclient import WebSocketDenialResponse
from starlette.websockets import WebSocketDisconnect

from model.bundle import load_bundle
from model.exceptions import InputError
from service.access import key_table, keyring
from service.access.keyring import KeyRing
from service.access.keys import digest, holder, new_key
from service.access.roles import ANYONE, Role
from service.app import create_app
from service.settings import Settings
from service.store.store import Store, open_store
from service.store.tables import audit
from service.store.tables import keys as key_rows
from service.stream.streams import REVOKED

ROUTES: dict[tuple[str, str], Role | None] = {
    ("GET", "/"): None,
    ("GET", "/page.css"): None,
    ("GET", "/page.js"): None,
    ("GET", "/healthz"): None,
    ("GET", "/readyz"): None,
    ("GET", "/metrics"): Role.VIEWER,
    ("GET", "/docs"): Role.VIEWER,
    ("GET", "/docs/assets/swagger-ui.css"): Role.VIEWER,
    ("GET", "/openapi.json"): Role.VIEWER,
    ("GET", "/v1/machines"): Role.VIEWER,
    ("GET", "/v1/machines/{name}"): Role.VIEWER,
    ("GET", "/v1/machines/{name}/errors"): Role.VIEWER,
    ("GET", "/v1/machines/{name}/audit"): Role.VIEWER,
    ("GET", "/v1/machines/{name}/measurements"): Role.VIEWER,
    ("GET", "/v1/machines/{name}/models"): Role.VIEWER,
    ("GET", "/v1/machines/{name}/map"): Role.GATEWAY,
    ("POST", "/v1/machines/{name}/telemetry"): Role.GATEWAY,
    ("POST", "/v1/machines/{name}/compensate"): Role.GATEWAY,
    ("POST", "/v1/machines/{name}/datum"): Role.GATEWAY,
    ("DELETE", "/v1/machines/{name}/datum"): Role.GATEWAY,
    ("POST", "/v1/machines/{name}/measurements"): Role.GATEWAY,
    ("WEBSOCKET", "/v1/machines/{name}/stream"): Role.GATEWAY,
    ("POST", "/v1/machines/{name}/models"): Role.ADMIN,
    ("POST", "/v1/machines/{name}/models/rollback"): Role.ADMIN,
    ("POST", "/v1/machines/{name}/models/{version}/activate"): Role.ADMIN,
    ("DELETE", "/v1/machines/{name}/models/{version}"): Role.ADMIN,
}
"""What each route needs; None is open to all. A route that is missing here fails a test."""
EVERYWHERE = "0.0.0.0"  # noqa: S104 (named, not bound)


class Guarded:
    """A service that needs keys, and a key of each role."""

    def __init__(self, client: TestClient, keys: dict[Role, str]) -> None:
        self.client, self.keys = client, keys

    def call(self, method: str, path: str, authorization: str | None) -> Any:
        headers = {} if authorization is None else {"authorization": authorization}
        path = path.format(name="tiny", version="none")
        if method != "WEBSOCKET":
            return self.client.request(method, path, headers=headers)
        try:
            with self.client.websocket_connect(path, headers=headers):
                return None
        except WebSocketDenialResponse as denial:
            return denial


@contextmanager
def guarded(store: Store, **settings: Any) -> Iterator[Guarded]:
    with store.engine.begin() as connection:
        keys = {role: key_table.create(connection, f"the {role}", role, NOON)[0] for role in Role}
    app = create_app([load_bundle(TINY)], Settings(**settings), store=store)
    with TestClient(app, raise_server_exceptions=False) as client:
        yield Guarded(client, keys)


@pytest.fixture(scope="module")
def service() -> Iterator[Guarded]:
    with open_store("sqlite://") as store, guarded(store) as running:
        yield running


def routes(app: FastAPI) -> set[tuple[str, str]]:
    found = set()
    for route in iter_route_contexts(app.routes):
        if isinstance(route.original_route, Mount):
            found.add(("GET", f"{route.path}/swagger-ui.css"))
        else:
            found |= {(method, route.path) for method in (route.methods or {"WEBSOCKET"}) - {"HEAD"}}
    return found


def test_no_route_is_forgotten(service: Guarded) -> None:
    assert routes(service.client.app) == set(ROUTES)  # type: ignore[arg-type]


@pytest.mark.parametrize(("method", "path"), ROUTES)
def test_a_route_without_a_key_and_with_a_wrong_one(service: Guarded, method: str, path: str) -> None:
    unknown, _ = new_key("unknown", Role.ADMIN, NOON)
    good = service.keys[Role.ADMIN]
    of_another_id = unknown[:15] + good[15:]
    for key, kind in (
        (None, "no-key"),
        (f"Digest {good}", "no-key"),
        (good, "no-key"),
        ("Bearer", "wrong-key"),
        (f"Bearer {unknown}", "wrong-key"),
        (f"Bearer {of_another_id}", "wrong-key"),
        (f"Bearer {good[:-1]}", "wrong-key"),
        (f"Bearer {good}0", "wrong-key"),
        (f"Bearer {good.upper()}", "wrong-key"),
    ):
        answer = service.call(method, path, key)
        if ROUTES[method, path] is None:
            assert answer.status_code == 200
            continue
        assert answer.status_code == 401
        body = answer.json()
        assert body["type"] == f"urn:thermotrue:problem:{kind}", (key, body)
        assert body["instance"] == path.format(name="tiny", version="none")
        assert 'Bearer realm="thermotrue"' in answer.headers["www-authenticate"]
        assert good not in answer.text


@pytest.mark.parametrize("role", Role)
@pytest.mark.parametrize(("method", "path"), ROUTES)
def test_a_route_with_a_key_of_each_role(service: Guarded, method: str, path: str, role: Role) -> None:
    answer = service.call(method, path, f"Bearer {service.keys[role]}")
    needed = ROUTES[method, path]
    if needed is None or role.includes(needed):
        assert answer is None or answer.status_code not in (401, 403)
        return
    assert answer.status_code == 403
    body = answer.json()
    assert body["type"] == "urn:thermotrue:problem:wrong-role"
    assert body["detail"].startswith(
        f"this call needs a key with the role '{needed}', got 'the {role}' with the role '{role}'; use another"
    )


def test_refusal_comes_before_the_body_is_read(service: Guarded) -> None:
    def parts() -> Iterator[bytes]:
        raise AssertionError("read")
        yield b""

    with suppress(AssertionError):  # of the client, which reads it to send it
        answer = service.client.post(f"{TINY_URL}/telemetry", content=parts())
        assert answer.status_code == 401
    answer = service.client.post(f"{TINY_URL}/telemetry", content=b"{" * 10_000_000)
    assert_problem(answer, 401, "no-key", "a key must come as 'Authorization: Bearer KEY', got none; make one")


def test_a_browser_may_send_the_key_as_a_password_for_the_documentation_alone(service: Guarded) -> None:
    basic = "Basic " + base64.b64encode(f"me:{service.keys[Role.VIEWER]}".encode()).decode()
    for path, status in (("/docs", 200), ("/openapi.json", 200), ("/v1/machines", 401), ("/docs/../metrics", 401)):
        answer = service.client.get(path, headers={"authorization": basic})
        assert answer.status_code == status, path
    asked = service.client.get("/docs").headers["www-authenticate"]
    assert asked.startswith("Basic realm=")
    assert "Basic" not in service.client.get("/metrics").headers["www-authenticate"]
    answer = service.client.get("/docs", headers={"authorization": "Basic %%%"})
    assert_problem(answer, 401, "no-key", "a key must come as 'Authorization: Bearer KEY', got another header")


def test_two_keys_in_one_request_are_none(service: Guarded) -> None:
    keys = [("authorization", f"Bearer {service.keys[role]}") for role in (Role.VIEWER, Role.ADMIN)]
    assert_problem(service.client.get("/v1/machines", headers=keys), 401, "no-key")


def test_secrets_are_compared_in_constant_time_known_or_not(monkeypatch: pytest.MonkeyPatch) -> None:
    compared = []

    def compare(a: str, b: str) -> bool:
        compared.append((len(a), len(b)))
        return a == b

    monkeypatch.setattr(hmac, "compare_digest", compare)
    key, record = new_key("a", Role.VIEWER, NOON)
    unknown, _ = new_key("b", Role.VIEWER, NOON)
    records = {record.id: record}
    assert holder(key, records) is not None
    assert holder(unknown, records) is None
    assert holder(f"tt_{record.id}_{'0' * 64}", records) is None
    assert compared == [(64, 64)] * 3


def test_a_record_does_not_give_the_key_away() -> None:
    key, record = new_key("a", Role.VIEWER, NOON)
    secret = key.rsplit("_", 1)[1]
    assert len(secret) * 4 == 256
    assert secret not in repr(record)
    assert record.hash == digest(secret) != secret
    others = {new_key("a", Role.VIEWER, NOON)[0] for _ in range(100)}
    assert len(others) == 100


def test_an_unknown_id_with_an_empty_secret_opens_nothing() -> None:
    for key in ("", "tt__", f"tt_{'0' * 12}_{'0' * 64}", "tt_" + "0" * 12 + "_", "é" * 80, "٠" * 80):
        assert holder(key, {}) is None


@pytest.mark.parametrize(
    ("settings", "made", "required"),
    [
        ({}, 0, False),
        ({"host": "localhost"}, 0, False),
        ({"host": "::1"}, 0, False),
        ({"host": "127.9.9.9"}, 0, False),
        ({}, 1, True),
        ({"host": EVERYWHERE}, 0, True),
        ({"host": "gateway.local"}, 0, True),
        ({"host": "::"}, 0, True),
        ({"keys": "required"}, 0, True),
        ({"keys": "off"}, 1, False),
        ({"keys": "off", "host": EVERYWHERE, "allow_open": True}, 1, False),
    ],
)
def test_when_keys_are_needed(settings: dict[str, Any], made: int, required: bool) -> None:
    with open_store("sqlite://") as store:
        for number in range(made):
            with store.engine.begin() as connection:
                key_table.create(connection, f"key {number}", Role.VIEWER, NOON)
        ring = KeyRing(store, Settings(**settings))
        assert ring.required is required
        assert (ring.anyone() is None) is required


def test_revoking_the_last_key_does_not_open_the_service(tmp_path: Path) -> None:
    with open_store(f"sqlite:///{tmp_path / 'a.db'}") as store, guarded(store) as service:
        viewer = {"authorization": f"Bearer {service.keys[Role.VIEWER]}"}
        assert service.client.get("/v1/machines", headers=viewer).status_code == 200
        with open_store(f"sqlite:///{tmp_path / 'a.db'}", lock=False) as beside, beside.engine.begin() as connection:
            for role in Role:
                key_table.revoke(connection, f"the {role}", NOON)
        began_s = time.monotonic()
        while service.client.get("/v1/machines", headers=viewer).status_code == 200:
            assert time.monotonic() - began_s < 5.0
            time.sleep(0.05)
        assert_problem(service.client.get("/v1/machines", headers=viewer), 401, "wrong-key")
        assert_problem(service.client.get("/v1/machines"), 401, "no-key")
        with store.engine.connect() as connection:
            actions = connection.execute(select(audit.c.action).where(audit.c.action.startswith("key "))).scalars()
            assert list(actions) == ["key created"] * 3 + ["key revoked"] * 3


def test_a_stream_ends_when_its_key_is_revoked(tmp_path: Path) -> None:
    with open_store(f"sqlite:///{tmp_path / 'a.db'}") as store, guarded(store) as service:
        headers = {"authorization": f"Bearer {service.keys[Role.GATEWAY]}"}
        with service.client.websocket_connect(f"{TINY_URL}/stream", headers=headers) as stream:
            stream.send_json({"positions": [MIDDLE]})
            assert "points" in stream.receive_json()
            with store.engine.begin() as connection:
                key_table.revoke(connection, f"the {Role.GATEWAY}", NOON)

            def ask_on() -> None:
                began_s = time.monotonic()
                while time.monotonic() - began_s < 5.0:
                    stream.send_json({"positions": [MIDDLE]})
                    stream.receive_json()
                    time.sleep(0.05)

            with pytest.raises(WebSocketDisconnect) as ended:
                ask_on()
            assert ended.value.code == REVOKED


def test_a_database_that_lost_its_keys_does_not_open_the_service(tmp_path: Path) -> None:
    with open_store(f"sqlite:///{tmp_path / 'a.db'}") as store:
        with store.engine.begin() as connection:
            key, _ = key_table.create(connection, "gw", Role.GATEWAY, NOON)
        ring = KeyRing(store, Settings())
        caller = ring.caller(key)
        assert caller is not None
        with store.engine.begin() as connection:
            connection.execute(key_rows.delete())
        pauses(ring, 1)
        assert ring.anyone() is None
        assert ring.caller(key) is None
        assert not ring.lets_in(caller)


def test_the_first_key_closes_a_running_service(tmp_path: Path) -> None:
    with open_store(f"sqlite:///{tmp_path / 'a.db'}") as store:
        ring = KeyRing(store, Settings())
        assert ring.anyone() is ANYONE
        assert ring.lets_in(ANYONE)
        with store.engine.begin() as connection:
            key, _ = key_table.create(connection, "gw", Role.GATEWAY, NOON)
        pauses(ring, 1)
        assert ring.anyone() is None
        assert not ring.lets_in(ANYONE)
        holder = ring.caller(key)
        assert holder is not None
        assert (holder.name, holder.role) == ("gw", Role.GATEWAY)


def test_keys_go_on_while_the_database_is_away(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with open_store(f"sqlite:///{tmp_path / 'a.db'}") as store:
        with store.engine.begin() as connection:
            key, _ = key_table.create(connection, "gw", Role.GATEWAY, NOON)
        ring = KeyRing(store, Settings())

        def fail(engine: Any) -> Any:
            raise OperationalError("select", None, Exception("gone"))

        monkeypatch.setattr(keyring, "_read", fail)
        pauses(ring, 3)
        assert ring.caller(key) is not None
        assert ring.anyone() is None


def pauses(ring: KeyRing, times: int) -> None:
    """Let the ring refresh its keys so many times."""
    left = [times]

    async def pause(seconds: float) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise asyncio.CancelledError

    with suppress(asyncio.CancelledError):
        asyncio.run(ring.refresh(pause))


def test_a_role_of_a_later_release_opens_nothing() -> None:
    with open_store("sqlite://") as store:
        with store.engine.begin() as connection:
            key, _ = key_table.create(connection, "gw", Role.GATEWAY, NOON)
            connection.execute(key_rows.update().values(role="auditor"))
        ring = KeyRing(store, Settings())
        assert ring.caller(key) is None


def test_names_are_one_keys_own_and_fit_for_logs() -> None:
    with open_store("sqlite://") as store, store.engine.begin() as connection:
        key_table.create(connection, "mill 1", Role.GATEWAY, NOON)
        with pytest.raises(InputError, match=r"a key's name must be its own, and 'mill 1' is in use; revoke"):
            key_table.create(connection, "mill 1", Role.VIEWER, NOON)
        for name in ("", "a\nb", "é", "x" * 65, " a"):
            with pytest.raises(InputError, match=r"a key's name must be up to 64 letters"):
                key_table.create(connection, name, Role.VIEWER, NOON)
        key_table.revoke(connection, "mill 1", NOON)
        with pytest.raises(InputError, match=r"there is no key in force with the id or name 'mill 1'"):
            key_table.revoke(connection, "mill 1", NOON)
        key_table.create(connection, "mill 1", Role.VIEWER, NOON)


@pytest.mark.parametrize(
    ("host", "origin", "status"),
    [
        ("127.0.0.1:8000", None, 200),
        ("127.0.0.1:8000", "http://127.0.0.1:8000", 200),
        ("localhost:8000", "http://localhost:8000", 200),
        ("[::1]:8000", "http://[::1]:8000", 200),
        ("127.0.0.1:8000", "https://evil.example", 403),
        ("127.0.0.1:8000", "http://127.0.0.1:9000", 403),
        ("127.0.0.1:8000", "null", 403),
        ("evil.example:8000", "http://evil.example:8000", 403),  # a name that was given this computer's address
        ("127.0.0.1:8000", "http://[", 403),
    ],
)
def test_pages_of_other_sites_do_not_steer_a_service_without_keys(host: str, origin: str | None, status: int) -> None:
    with open_store("sqlite://") as store:
        client = TestClient(create_app([load_bundle(TINY)], Settings(), store=store), raise_server_exceptions=False)
        with client:
            headers = {"host": host} | ({} if origin is None else {"origin": origin})
            answer = client.delete(f"{TINY_URL}/datum", headers=headers)
            assert answer.status_code == status
            if status == 403:
                assert_problem(answer, 403, "foreign-origin", "without keys a page in a browser must be the service's")


def test_the_description_says_how_to_send_a_key(service: Guarded) -> None:
    headers = {"authorization": f"Bearer {service.keys[Role.VIEWER]}"}
    described = service.client.get("/openapi.json", headers=headers).json()
    assert described["components"]["securitySchemes"]["key"]["scheme"] == "bearer"
    for path, operations in described["paths"].items():
        for method, operation in operations.items():
            needed = ROUTES[method.upper(), path]
            assert operation["security"] == ([] if needed is None else [{"key": []}])
            if needed is not None:
                [named] = re.findall(r"Needs a key with the role `(\w+)`", operation["description"])
                assert named == needed
