"""More rows than may wait for the database: nobody is told that a sample is stored which is not."""

import threading
import time
from collections import Counter
from collections.abc import Iterator

import pytest
from service_client import NOON, TINY_URL, Service, assert_problem, sample, serving
from sqlalchemy import Connection, select

from service import recorder
from service.store import journal as journal_file
from service.store.journal import Journal
from service.store.store import Store
from service.store.tables import telemetry

MOST = 10


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Iterator[Service]:
    monkeypatch.setattr(journal_file, "MAX_QUEUED_ROWS", MOST)
    with serving() as found:
        yield found


def fill(service: Service, release: threading.Event) -> Journal:
    """Let a transaction take until the event, and queue as much as may be."""
    store: Store = service.client.app.state.store  # type: ignore[attr-defined]
    journal = store.journal

    def hold(connection: Connection) -> None:
        release.wait(5.0)

    journal.add(hold)
    time.sleep(0.05)
    while not journal.full:
        journal.add(lambda _: None)
    return journal


def stored(service: Service) -> Counter[float]:
    store: Store = service.client.app.state.store  # type: ignore[attr-defined]
    with store.engine.connect() as connection:
        return Counter(connection.execute(select(telemetry.c.time_s)).scalars())


def test_a_sample_that_is_not_queued_is_not_acknowledged_though_the_rest_is_stored_at_once(service: Service) -> None:
    """A database that is slow, or has just come back, may write all that waits before the answer is due."""
    release = threading.Event()
    journal = fill(service, release)
    threading.Timer(0.2, release.set).start()
    three = {"samples": [sample(NOON - 60.0 * n) for n in range(3)]}
    answer = service.client.post(f"{TINY_URL}/telemetry", json=three)
    assert journal.failure is None
    assert_problem(answer, 503, "storage-unavailable", "the database must take writes, and too many rows waited")
    assert answer.headers["retry-after"]
    assert not stored(service)
    for _ in range(3):  # sent again until it is acknowledged, and once more
        again = service.client.post(f"{TINY_URL}/telemetry", json={"samples": three["samples"] * 2})
        assert (again.status_code, again.json()["ignored"]) == (200, 6)
        assert stored(service) == {NOON: 1, NOON - 60.0: 1, NOON - 120.0: 1}


def test_sent_again_while_too_many_wait_still_it_is_not_acknowledged_either(service: Service) -> None:
    for _ in range(2):
        release = threading.Event()
        fill(service, release)
        threading.Timer(0.2, release.set).start()
        answer = service.client.post(f"{TINY_URL}/telemetry", json={"samples": [sample(NOON)]})
        assert_problem(answer, 503, "storage-unavailable")
    assert service.client.post(f"{TINY_URL}/telemetry", json={"samples": [sample(NOON)]}).status_code == 200
    assert stored(service) == {NOON: 1}


def test_what_is_remembered_as_missing_is_bounded(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "MOST_MISSING", 5)
    release = threading.Event()
    fill(service, release)
    samples = {"samples": [sample(NOON - 100.0 + n) for n in range(8)]}
    threading.Timer(0.2, release.set).start()
    assert service.client.post(f"{TINY_URL}/telemetry", json=samples).status_code == 503
    assert service.client.post(f"{TINY_URL}/telemetry", json=samples).status_code == 200
    assert stored(service) == {NOON - 100.0 + n: 1 for n in range(3, 8)}
