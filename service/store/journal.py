"""The journal: one thread that writes, many operations to a transaction.

Requests queue operations and wait until they are durable. A disk takes perhaps a hundred transactions a second, so
whatever came while one was under way goes into the next together. While the database fails the queue grows in
memory, up to a bound, and is written once the database is back, in order.
"""

from __future__ import annotations

import asyncio
import logging
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from typing import Any

from sqlalchemy import Connection, Table, select
from sqlalchemy.exc import DataError, DBAPIError, IntegrityError, SQLAlchemyError

from service.store.database import Database
from service.store.tables import journal as journal_table
from service.store.unavailable import StorageUnavailable

log = logging.getLogger(__name__)

MAX_QUEUED_ROWS = 100_000
"""How many rows wait at most for a database that fails. A sample takes about 1 kB here, so that is 100 MB, or a
quarter of an hour of 100 machines at one sample a second."""
MAX_GROUP = 2000
"""Operations in one transaction at most, so that the first of them does not wait for long."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.05, 1.0
"""Between attempts on a database that fails [s]."""
SLOW_S = 5.0
"""From when on a transaction under way counts as a failure [s]: a disk or a connection that hangs tells nothing."""

DURABLE_S = 2.0
"""How long a request waits until what it sent is durable [s]: a disk takes 20 ms, and a client gives up after some
seconds."""

Operation = Callable[[Connection], None]


@dataclass(frozen=True)
class Insert:
    """An operation: rows for one table. Neighbours in the journal are written as one."""

    table: Table
    rows: Sequence[Mapping[str, Any]]

    def __call__(self, connection: Connection) -> None:
        """Write them."""
        connection.execute(self.table.insert(), list(self.rows))


@dataclass
class _Entry:
    operation: Operation
    future: asyncio.Future[None] | None
    key: Hashable | None = None

    @property
    def weight(self) -> int:
        return len(self.operation.rows) if isinstance(self.operation, Insert) else 1


class Journal:
    """The queue and its thread, which starts with the first operation.

    Parameters
    ----------
    database : gives transactions
    """

    def __init__(self, database: Database) -> None:
        self._database = database
        self._changed = threading.Condition()
        self._queue: deque[_Entry] = deque()
        self._latest: dict[Hashable, _Entry] = {}
        self._waiting: deque[tuple[int, asyncio.Future[None]]] = deque()
        self._queued = self._done = self._weight = 0
        self._thread: threading.Thread | None = None
        self._failure: str | None = None
        self._begun_s: float | None = None
        self._closing_s: float | None = None
        self._writer, self._batch, self._uncertain = uuid.uuid4().hex, 0, False

    @property
    def failure(self) -> str | None:
        """Why nothing can be written now; None while all is well."""
        begun_s = self._begun_s
        if self._failure is None and begun_s is not None and time.monotonic() - begun_s > SLOW_S:
            return f"and one has been under way for {time.monotonic() - begun_s:.0f} s"
        return self._failure

    @property
    def queued_rows(self) -> int:
        """How many rows are not durable yet."""
        return self._weight

    @property
    def full(self) -> bool:
        """Whether no more rows are taken until some are written."""
        return self._weight >= MAX_QUEUED_ROWS

    def write(self, operation: Operation) -> asyncio.Future[None]:
        """Queue an operation; the future is done once its transaction is durable.

        Operations are plain inserts, updates and deletes. They run in the order in which they were queued, and
        again where a transaction failed.

        Raises
        ------
        StorageUnavailable
            where `MAX_QUEUED_ROWS` wait already, or the journal is closed.
        """
        self._refuse_where_full()
        future = asyncio.get_running_loop().create_future()
        future.add_done_callback(_retrieve)
        self._append(_Entry(operation, future))
        return future

    def add(self, operation: Operation) -> None:
        """Queue an operation, as `write`, where nobody waits for this one alone."""
        self._refuse_where_full()
        self._append(_Entry(operation, None))

    def write_latest(self, key: Hashable, operation: Operation) -> None:
        """Queue an operation in place of the one of the same key, where that still waits."""
        with self._changed:
            waiting = self._latest.get(key)
            if waiting is not None:
                waiting.operation = operation
                return
        self._append(_Entry(operation, None, key))

    async def durable(self, within_s: float) -> None:
        """Return once all that is queued now is durable.

        Raises
        ------
        StorageUnavailable
            where that takes longer, or the database fails already.
        """
        with self._changed:
            if self._done >= self._queued:
                return
            if self.failure is not None:
                raise StorageUnavailable(self.failure)
            future = asyncio.get_running_loop().create_future()
            future.add_done_callback(_retrieve)
            self._waiting.append((self._queued, future))
        try:
            await asyncio.wait_for(future, within_s)
        except TimeoutError:
            raise StorageUnavailable(self.failure or f"and did not within {within_s:g} s") from None

    def close(self, within_s: float = 5.0) -> None:
        """Write what is queued, and end the thread; what cannot be written in time is lost and logged."""
        with self._changed:
            self._closing_s = time.monotonic() + within_s
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(within_s + 1.0)
        if self._queue:
            log.error("not stored", extra={"operations": len(self._queue), "reason": self.failure or "no time"})
        self._finish(list(self._queue), StorageUnavailable("and the service has stopped"))

    def _refuse_where_full(self) -> None:
        if self.full:
            waiting = f"{self._weight} rows wait, so this was not queued"
            raise StorageUnavailable(f"{self.failure or 'and is slow'}; {waiting}")

    def _append(self, entry: _Entry) -> None:
        with self._changed:
            if self._closing_s is not None:
                raise StorageUnavailable("and the service is stopping")
            self._queue.append(entry)
            self._queued += 1
            self._weight += entry.weight
            if entry.key is not None:
                self._latest[entry.key] = entry
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="journal", daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._queue and self._closing_s is None:
                    self._changed.wait()
                if not self._queue:
                    return
                group = list(islice(self._queue, MAX_GROUP))
                for entry in group:
                    if entry.key is not None:
                        del self._latest[entry.key]
            failed = self._store(group)
            if failed is None:
                return
            with self._changed:
                for entry in group:
                    self._queue.popleft()
                    self._weight -= entry.weight
                self._done += len(group)
                self._failure = self._begun_s = None
            self._finish([e for e in group if id(e) not in failed], None)

    def _store(self, group: list[_Entry]) -> set[int] | None:
        """Write a group, however long that takes; None where the service stops first.

        Returns the entries that were refused, by identity: a fault in the program, which must not hold up the rest.
        """
        pause_s = FIRST_PAUSE_S
        self._batch += 1
        while True:
            try:
                self._write([e.operation for e in group])
                break
            except (IntegrityError, DataError) as problem:
                return self._one_by_one(group, problem)
            except (SQLAlchemyError, OSError) as problem:
                if isinstance(problem, SQLAlchemyError) and not _of_the_database(problem):
                    return self._one_by_one(group, problem)
                self._fail(problem)
            except Exception as problem:
                return self._one_by_one(group, problem)
            with self._changed:
                if self._closing_s is not None and time.monotonic() > self._closing_s:
                    return None
                self._changed.wait_for(lambda: self._closing_s is not None, pause_s)
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)
        if self._failure is not None:
            log.info("database takes writes again")
        return set()

    def _write(self, operations: Sequence[Operation]) -> None:
        self._begun_s = time.monotonic()
        if self._uncertain and self._written():
            self._uncertain = False
            return
        self._uncertain = True
        with self._database.transaction() as connection:
            values = {"writer": self._writer, "batch": self._batch}
            if not connection.execute(journal_table.update(), values).rowcount:
                connection.execute(journal_table.insert(), {"id": 1, **values})
            for operation in merged(operations):
                operation(connection)
        self._uncertain = False

    def _written(self) -> bool:
        """Return whether the transaction that seemed to fail had been committed."""
        with self._database.transaction() as connection:
            row = connection.execute(select(journal_table.c.writer, journal_table.c.batch)).first()
        return row is not None and (row.writer, row.batch) == (self._writer, self._batch)

    def _one_by_one(self, group: list[_Entry], problem: Exception) -> set[int] | None:
        if len(group) == 1:
            log.error("operation refused by the database", extra={"reason": reason(problem)}, exc_info=problem)
            self._finish(group, problem)
            return {id(group[0])}
        refused: set[int] = set()
        for entry in group:
            found = self._store([entry])
            if found is None:
                return None
            refused |= found
        return refused

    def _fail(self, problem: Exception) -> None:
        sentence = f"and fails: {reason(problem)}"
        if self._failure is None:
            log.error("database takes no writes", extra={"reason": reason(problem)})
        self._failure = sentence
        self._database.drop()
        with self._changed:
            waiting = [f for _, f in self._waiting]
            self._waiting.clear()
        _resolve(waiting, StorageUnavailable(sentence))

    def _finish(self, entries: list[_Entry], problem: Exception | None) -> None:
        futures = [e.future for e in entries if e.future is not None]
        _resolve(futures, problem)
        ready = []
        with self._changed:
            while self._waiting and (problem is not None or self._waiting[0][0] <= self._done):
                ready.append(self._waiting.popleft()[1])
        _resolve(ready, None if problem is None else StorageUnavailable("and refused a part of what was written"))


def merged(operations: Sequence[Operation]) -> list[Operation]:
    """Return the operations with neighbouring rows of one table as one."""
    result: list[Operation] = []
    rows: list[Mapping[str, Any]] = []
    table: Table | None = None
    for operation in operations:
        if not isinstance(operation, Insert):
            table = None
            result.append(operation)
        elif operation.table is table:
            rows.extend(operation.rows)
        else:
            table, rows = operation.table, list(operation.rows)
            result.append(Insert(table, rows))
    return result


def reason(problem: BaseException) -> str:
    """Return what the database said, in one line."""
    said = problem.orig if isinstance(problem, DBAPIError) and problem.orig is not None else problem
    return " ".join(str(said).split()) or type(said).__name__


def _of_the_database(problem: SQLAlchemyError) -> bool:
    """Return whether the database is at fault and not the program: its driver said so, or no connection is free."""
    return isinstance(problem, DBAPIError) or "pool" in str(problem).lower()


def _retrieve(future: asyncio.Future[None]) -> None:
    """Look at the outcome, so that asyncio does not complain about one that nobody waits for."""
    if not future.cancelled():
        future.exception()


def _resolve(futures: Sequence[asyncio.Future[None]], problem: Exception | None) -> None:
    """Finish futures from the journal's thread, with one call to each loop."""
    loops: dict[asyncio.AbstractEventLoop, list[asyncio.Future[None]]] = {}
    for future in futures:
        loops.setdefault(future.get_loop(), []).append(future)
    for loop, own in loops.items():
        with suppress(RuntimeError):  # the loop is closed: nobody waits any more
            loop.call_soon_threadsafe(_settle, own, problem)


def _settle(futures: Sequence[asyncio.Future[None]], problem: Exception | None) -> None:
    for future in futures:
        if not future.done():
            if problem is None:
                future.set_result(None)
            else:
                future.set_exception(problem)
