"""What the OpenAPI description promises, the service keeps: schemathesis calls everything, with all its checks."""

import io
import zipfile
from typing import Any

import pytest
import schemathesis
from hypothesis import strategies as st
from schemathesis.config import SchemathesisConfig
from schemathesis.engine import Status, events, from_schema
from schemathesis.python import asgi
from service_client import NOON, TINY

from model.bundle import load_bundle
from service.access import key_table
from service.access.roles import Role
from service.app import create_app
from service.settings import Settings
from service.store.store import Store, open_store

EXAMPLES, FEW = 20, 5
"""For each operation, besides those that the description shows and those that go through its every corner."""


def archive(folder: Any = TINY) -> bytes:
    """Return a bundle as it is uploaded."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as zipped:
        for file in sorted(folder.iterdir()):
            zipped.writestr(file.name, file.read_bytes())
    return stream.getvalue()


def as_bytes(context: Any, value: Any) -> dict[str, Any]:
    return {"data": value if isinstance(value, bytes) else str(value).encode(errors="replace")}


BINARY = ("application/zip", "application/vnd.apache.arrow.stream")
schemathesis.serializer(*BINARY)(as_bytes)
for media_type, valid in zip(BINARY, (archive(), b""), strict=True):
    schemathesis.openapi.media_type(media_type, st.sampled_from([valid, b"", b"PK\3\4"]) | st.binary(max_size=100))


def run(store: Store, headers: dict[str, str], examples: int) -> tuple[list[str], set[str]]:
    """Run all phases over all operations, and return what was found and which operations were called."""
    app = create_app([load_bundle(TINY)], Settings(max_requests_per_s=0), store=store)
    configuration = SchemathesisConfig.from_dict(
        {
            "seed": 1,
            "headers": headers,
            "generation": {"max-examples": examples, "database": "none"},
            "parameters": {"path.name": "tiny"},
            # The names of axes and sensors are the machine's, and times lie near the clock's: no schema can say so.
            "checks": {
                "positive_data_acceptance": {"expected-statuses": ["2xx", "401", "403", "404", "409", "415", "422"]}
            },
        }
    )
    schema = schemathesis.openapi.from_asgi("/openapi.json", app, config=configuration, headers=headers)
    found, called = [], set()
    for event in from_schema(schema).execute():
        if isinstance(event, events.NonFatalError | events.FatalError):
            found.append(str(getattr(event, "value", None) or event.exception))  # type: ignore[union-attr]
        elif isinstance(event, events.ScenarioFinished):
            called.add(event.recorder.label)
            for case, checks in event.recorder.checks.items():
                for check in checks:
                    if check.status is Status.FAILURE and check.failure_info is not None:
                        failure = check.failure_info.failure
                        found.append(f"{check.name} {failure.operation} {failure.message} {case}")
    return found, called


@pytest.mark.parametrize(("with_keys", "examples"), [(False, FEW), (True, EXAMPLES)])
def test_nothing_breaks_a_promise(with_keys: bool, examples: int) -> None:
    with open_store("sqlite://") as store:
        headers = {}
        if with_keys:
            with store.engine.begin() as connection:
                key, _ = key_table.create(connection, "all", Role.ADMIN, NOON)
            headers = {"Authorization": f"Bearer {key}"}
        try:
            found, called = run(store, headers, examples)
        finally:
            asgi.shutdown_lifespans()  # before the store is closed
    assert not found, "\n".join(found[:5])
    assert {"GET /healthz", "POST /v1/machines/{name}/compensate", "DELETE /v1/machines/{name}/datum"} <= called
