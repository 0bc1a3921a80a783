"""A database that is locked, gone, full or cut off: nothing is lost or written twice, and it recovers by itself."""

import asyncio
import logging
import resource
import shutil
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import psycopg
import pytest
from service_client import NOON, TINY_URL, assert_problem, correction_um, sample, serving
from sqlalchemy import Connection, select, text
from store_databases import POSTGRESQL, schema

from service.store import journal as journal_file
from service.store.database import lock_number
from service.store.journal import Insert, Operation, merged
from service.store.store import Store, open_store
from service.store.tables import audit, telemetry
from service.store.unavailable import StorageUnavailable


def row(number: int, text: str = "{}") -> Insert:
    return Insert(telemetry, [{"machine": "m", "time_s": float(number), "received_s": 0.0, "sample": text}])


async def stored(store: Store, number: int, within_s: float = 0.3) -> None:
    store.journal.write(row(number))
    await store.journal.durable(within_s)


async def recovered(store: Store) -> None:
    """Wait until all that was queued is durable."""
    for _ in range(200):
        try:
            return await store.journal.durable(1.0)
        except StorageUnavailable:
            await asyncio.sleep(0.05)
    raise AssertionError(store.journal.failure)


def numbers(store: Store) -> list[float]:
    with store.engine.connect() as connection:
        return list(connection.execute(select(telemetry.c.time_s).order_by(telemetry.c.id)).scalars())


@contextmanager
def locked(path: Path) -> Iterator[None]:
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        yield
        other.execute("ROLLBACK")


@contextmanager
def gone(path: Path) -> Iterator[None]:
    """The folder is moved away, as where a volume is not there."""
    elsewhere = path.parent.with_name("elsewhere")
    path.parent.rename(elsewhere)
    yield
    elsewhere.rename(path.parent)


@contextmanager
def full(path: Path) -> Iterator[None]:
    """No file of this process grows, which SQLite takes for a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    size = path.with_name(path.name + "-wal").stat().st_size
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


FAULTS = {"locked": locked, "gone": gone, "full": full}


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.store.database.BUSY_S", 0.1)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_database_that_fails_loses_nothing_and_recovers(fault: str, tmp_path: Path) -> None:
    path = tmp_path / "data" / "thermotrue.db"

    async def run() -> None:
        with open_store(f"sqlite:///{path}") as store:
            await stored(store, 0)
            with FAULTS[fault](path):
                for number in (1, 2, 3):
                    with pytest.raises(StorageUnavailable, match="the database must take writes, and "):
                        await stored(store, number, 1.0)
                assert store.journal.failure is not None
                assert store.journal.queued_rows == 3
            await recovered(store)
            assert store.journal.failure is None
            await stored(store, 4)
            assert numbers(store) == [0.0, 1.0, 2.0, 3.0, 4.0]

    asyncio.run(run())
    with open_store(f"sqlite:///{path}") as store:
        assert numbers(store) == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_a_database_put_back_from_a_copy_gets_what_it_lacks(tmp_path: Path) -> None:
    """What was acknowledged before is the copy's affair; what was not, is written to the new file."""
    path, copy = tmp_path / "t.db", tmp_path / "copy.db"
    with open_store(f"sqlite:///{copy}"):
        pass

    async def run() -> None:
        with open_store(f"sqlite:///{path}") as store:
            await stored(store, 0)
            path.unlink()
            path.with_name("t.db-wal").unlink()
            with pytest.raises(StorageUnavailable, match=r".*is gone: no such file|.*unable to open"):
                await stored(store, 1)
            shutil.copy(copy, path)
            await recovered(store)
            assert numbers(store) == [1.0]

    asyncio.run(run())


def test_connections_that_are_cut_lose_nothing_and_store_nothing_twice(caplog: pytest.LogCaptureFixture) -> None:
    async def run(url: str) -> None:
        with open_store(url) as store, psycopg.connect(POSTGRESQL, autocommit=True) as admin:
            with store.engine.connect() as connection:
                name = str(connection.execute(text("SELECT current_schema()")).scalar())
            cut = "SELECT pg_terminate_backend(pid) FROM pg_locks WHERE locktype = 'advisory' AND objid = %s"
            for number in range(60):
                store.journal.write(row(number))
                if number % 6 == 0:
                    admin.execute(cut, [lock_number(name)])
                await asyncio.sleep(0.01)
            await recovered(store)
            assert numbers(store) == [float(n) for n in range(60)]

    with schema() as url:
        asyncio.run(run(url))
    assert "database takes no writes" in [r.message for r in caplog.records], "it was cut off"


def test_a_transaction_that_seemed_to_fail_is_not_written_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The connection may break after the commit and before the answer."""

    async def run() -> None:
        with open_store(f"sqlite:///{tmp_path / 't.db'}") as store:
            await stored(store, 0)
            database = store._database
            check, failures = database._check, [OSError("cut off"), OSError("again")]  # type: ignore[attr-defined]

            def cut() -> None:
                if failures:
                    raise failures.pop()
                check()

            monkeypatch.setattr(database, "_check", cut)
            with pytest.raises(StorageUnavailable, match=r".*and fails: again"):
                await stored(store, 1)
            await recovered(store)
            assert numbers(store) == [0.0, 1.0]

    asyncio.run(run())


def test_an_operation_that_cannot_work_does_not_hold_up_the_others(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(connection: Connection) -> None:
        raise ZeroDivisionError

    async def run() -> None:
        with open_store(f"sqlite:///{tmp_path / 't.db'}") as store:
            hold = threading.Event()
            store.journal.write(lambda connection: hold.wait(5.0) and None)
            await asyncio.sleep(0.05)
            outcomes = [store.journal.write(o) for o in (row(1), broken, row(2))]
            waiting = asyncio.create_task(store.journal.durable(5.0))
            await asyncio.sleep(0)
            hold.set()
            found = await asyncio.gather(*outcomes, return_exceptions=True)
            assert [type(f) for f in found] == [type(None), ZeroDivisionError, type(None)]
            with pytest.raises(
                StorageUnavailable, match=r".*refused a part"
            ):  # whoever waits is not told that all is well
                await waiting
            await stored(store, 3)
            assert numbers(store) == [1.0, 2.0, 3.0]

    asyncio.run(run())
    assert [r.message for r in caplog.records if r.levelno == logging.ERROR] == ["operation refused by the database"]


def test_the_queue_has_an_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_file, "MAX_QUEUED_ROWS", 3)
    path = tmp_path / "t.db"

    async def run() -> None:
        with open_store(f"sqlite:///{path}") as store:
            with locked(path):
                for number in range(3):
                    store.journal.write(row(number))
                with pytest.raises(StorageUnavailable, match=r".*3 rows wait, so this was not queued"):
                    store.journal.write(row(3))
            await recovered(store)
            assert numbers(store) == [0.0, 1.0, 2.0]

    asyncio.run(run())


def test_many_operations_share_a_transaction(tmp_path: Path) -> None:
    commits = []

    async def run() -> None:
        with open_store(f"sqlite:///{tmp_path / 't.db'}") as store:
            transaction = store._database.transaction
            store._database.transaction = lambda: commits.append(1) or transaction()  # type: ignore[method-assign]
            await asyncio.gather(*(stored(store, n, 10.0) for n in range(500)))
            assert sorted(numbers(store)) == [float(n) for n in range(500)]

    asyncio.run(run())
    assert len(commits) < 50


def test_only_neighbours_of_one_table_are_merged() -> None:
    def other(connection: Connection) -> None: ...

    entry = Insert(audit, [{"who": "me"}])
    queued: list[Operation] = [row(1), row(2), entry, row(3), other, row(4), row(5)]
    found = merged(queued)
    assert [len(o.rows) if isinstance(o, Insert) else 0 for o in found] == [2, 1, 1, 0, 2]
    assert [r for o in found if isinstance(o, Insert) for r in o.rows] == [
        r for o in queued if isinstance(o, Insert) for r in o.rows
    ]
    assert queued[0] == row(1), "the operations themselves stay as they are, for another attempt"


def test_the_latest_of_a_kind_replaces_what_still_waits(tmp_path: Path) -> None:
    async def run() -> None:
        with open_store(f"sqlite:///{tmp_path / 't.db'}") as store:
            hold = threading.Event()
            store.journal.write(lambda connection: hold.wait(5.0) and None)
            await asyncio.sleep(0.05)
            for number in range(5):
                store.journal.write_latest("a", row(number))
                store.journal.write_latest("b", row(10 + number))
            hold.set()
            await store.journal.durable(5.0)
            assert numbers(store) == [4.0, 14.0]

    asyncio.run(run())


def test_a_transaction_that_hangs_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_file, "SLOW_S", 0.05)

    async def run() -> None:
        with open_store("sqlite://") as store:
            hold = threading.Event()
            store.journal.write(lambda connection: hold.wait(5.0) and None)
            await asyncio.sleep(0.2)
            assert (store.journal.failure or "").startswith("and one has been under way for ")
            hold.set()
            await recovered(store)
            assert store.journal.failure is None

    asyncio.run(run())


@pytest.mark.parametrize("fault", FAULTS)
def test_compensation_goes_on_while_the_database_fails(fault: str, tmp_path: Path) -> None:
    path = tmp_path / "data" / "thermotrue.db"
    with serving(database=f"sqlite:///{path}") as service:
        service.warm(end=NOON - 100.0)
        before = correction_um(service.compensate())
        with FAULTS[fault](path):
            body = {"samples": [sample(NOON - 50.0, 31.0)]}
            answer = service.client.post(f"{TINY_URL}/telemetry", json=body)
            assert_problem(answer, 503, "storage-unavailable", "the database must take writes, and ")
            assert answer.headers["retry-after"] == "5"
            wait_until(lambda: service.client.get("/readyz").status_code == 503)
            assert_problem(service.client.get("/readyz"), 503, "storage-unavailable", "the database must take writes")
            assert service.client.get("/healthz").status_code == 200
            service.clock[0] += 60.0
            after = correction_um(service.compensate(temperatures=body["samples"][0]["temperatures"]))
            assert after.max() > before.max(), "the sample counts at once"
            for method in (service.client.post, service.client.delete):
                answer = method(f"{TINY_URL}/datum")
                assert_problem(answer, 503, "storage-unavailable", "the database must take writes, and ")
                assert answer.json()["detail"].endswith("; the datum stays as it was; set it again later")
            assert service.get()["datum"]["kind"] == "absolute"
        wait_until(lambda: service.client.get("/readyz").status_code == 200)
        reply = service.telemetry(*body["samples"])
        assert (reply["accepted"], reply["ignored"]) == (0, 1)
    with open_store(f"sqlite:///{path}") as store:
        assert set(numbers(store)) >= {NOON - 50.0, NOON + 60.0}


def test_a_sample_for_which_there_was_no_room_is_stored_when_it_comes_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journal_file, "MAX_QUEUED_ROWS", 4)
    path = tmp_path / "thermotrue.db"
    times = [NOON - 60.0 + n for n in range(8)]
    with serving(database=f"sqlite:///{path}") as service:
        with locked(path):
            for time_s in times:
                answer = service.client.post(f"{TINY_URL}/telemetry", json={"samples": [sample(time_s)]})
                assert answer.status_code == 503
        wait_until(lambda: service.client.get("/readyz").status_code == 200)
        assert service.telemetry(*map(sample, times))["ignored"] == 8
        assert service.telemetry(*map(sample, times))["ignored"] == 8
    with open_store(f"sqlite:///{path}") as store:
        assert set(numbers(store)) >= set(times)


def wait_until(holds: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 15.0
    while not holds():
        assert time.monotonic() < end_s
        time.sleep(0.05)
