"""Where the journal writes: a file of SQLite, a schema of PostgreSQL, or memory. The same statements for all."""

from __future__ import annotations

import os
import sqlite3
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import quote

from sqlalchemy import Connection, Engine, create_engine, event, text
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, OperationalError
from sqlalchemy.pool import QueuePool

from model.exceptions import InputError
from service.store.file_lock import FileLock

BUSY_S = 2.0
"""How long SQLite waits for another process' lock [s]."""
LOCK_KEY = 0x74686572
"""First half of PostgreSQL's advisory lock: 'ther'. The second half names the schema."""
LOCK_WAIT_S = 5.0
"""How long a start waits for the lock of a service that has just ended [s]."""
SERVER_OPTIONS = (
    "-c statement_timeout=10000 -c lock_timeout=2000 -c idle_in_transaction_session_timeout=60000 "
    "-c tcp_keepalives_idle=10 -c tcp_keepalives_interval=5 -c tcp_keepalives_count=3"
)
"""A server or a network that hangs must end in an error, and a client that is gone must give its lock back."""


class Database(Protocol):
    """A database that is open.

    Attributes
    ----------
    engine : for reads
    name : for messages, without a password
    lasting : whether it outlives the process
    """

    engine: Engine
    name: str
    lasting: bool

    def transaction(self) -> Any:
        """Return a context with a connection; what was done in it is durable when it ends."""

    def drop(self) -> None:
        """Forget the connection that transactions use, after one has failed."""

    def close(self) -> None:
        """Give everything back."""


def open_database(url: str, *, lock: bool) -> Database:
    """Open the database of a URL.

    Parameters
    ----------
    lock : refuse where another process has it open with a lock

    Raises
    ------
    InputError
        where the URL is not one of SQLite or PostgreSQL, or another service runs on it.
    """
    try:
        parsed = make_url(url)
    except (ArgumentError, ValueError):
        raise InputError(_must_be("text that is not a URL")) from None
    backend = parsed.get_backend_name()
    if backend == "sqlite" and parsed.database in (None, "", ":memory:"):
        return MemoryDatabase()
    if backend == "sqlite":
        assert parsed.database is not None
        return FileDatabase(Path(parsed.database).absolute(), lock=lock)
    if backend in ("postgresql", "postgres"):
        return ServerDatabase(parsed.set(drivername="postgresql+psycopg"), lock=lock)
    raise InputError(_must_be(f"'{parsed.render_as_string(hide_password=True)}'"))


def _must_be(got: str) -> str:
    return f"database must be sqlite:///FILE or postgresql://USER@HOST/NAME, got {got}"


class MemoryDatabase:
    """SQLite in memory, for simulations and tests: one connection, which one user at a time has."""

    name, lasting = "memory", False

    def __init__(self) -> None:
        self.engine = create_engine(
            "sqlite://",
            poolclass=QueuePool,
            pool_size=1,
            max_overflow=0,
            connect_args={"check_same_thread": False},
        )

    @contextmanager
    def transaction(self) -> Iterator[Connection]:
        """Return a transaction on the one connection."""
        with self.engine.begin() as connection:
            yield connection

    def drop(self) -> None:
        """Keep it: all is in it."""

    def close(self) -> None:
        """End it, and forget all."""
        self.engine.dispose()


class _Lasting:
    """A database that outlives the process; transactions share one connection until one fails."""

    engine: Engine
    lasting = True

    def __init__(self) -> None:
        self._connection: Connection | None = None

    @contextmanager
    def transaction(self) -> Iterator[Connection]:
        """Return a transaction on the writing connection."""
        if self._connection is None:
            self._connection = self._connect()
        with self._connection.begin():
            yield self._connection
        self._check()

    def drop(self) -> None:
        """Close the writing connection."""
        connection, self._connection = self._connection, None
        if connection is not None:
            with suppress(Exception):
                connection.invalidate()
            with suppress(Exception):
                connection.close()

    def close(self) -> None:
        """Close all connections."""
        self.drop()
        self.engine.dispose()

    def _connect(self) -> Connection:
        return self.engine.connect()

    def _check(self) -> None:
        """Raise where what was committed is not where it will be looked for."""


class FileDatabase(_Lasting):
    """A file of SQLite, with a write-ahead log that is on the disk before a transaction counts as done.

    Raises
    ------
    InputError
        where another service runs on it, or its folder cannot be written to.
    """

    def __init__(self, path: Path, *, lock: bool) -> None:
        super().__init__()
        self.name = str(path)
        self._path = path
        self._lock: FileLock | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if lock:
                self._lock = FileLock(path.with_name(path.name + ".lock"))
            path.touch(mode=0o600)
        except OSError as problem:
            raise InputError(
                f"database '{path}' must be a file that can be written to: {problem.strerror}; "
                "name another place by --data-dir"
            ) from None
        if self._lock is not None and not self._lock.taken:
            raise InputError(
                f"database '{path}' is in use by another service; stop that, or give this one its own by --data-dir"
            )
        self.engine = create_engine("sqlite+pysqlite://", creator=self._open, poolclass=QueuePool, max_overflow=30)
        event.listen(self.engine, "connect", _set_pragmas)
        self._files: dict[Path, tuple[int, int]] = {}

    def close(self) -> None:
        """Close all connections, and give the lock back."""
        super().close()
        if self._lock is not None:
            self._lock.release()

    def _open(self) -> sqlite3.Connection:
        # Never a new file in place of one that is gone: what was acknowledged would be missing in it.
        where = f"file:{quote(str(self._path))}?mode=rw"
        return sqlite3.connect(where, uri=True, timeout=BUSY_S, check_same_thread=False)

    def _connect(self) -> Connection:
        self.engine.dispose()  # readers would go on with the file that was there before
        connection = self.engine.connect()
        connection.exec_driver_sql("SELECT count(*) FROM sqlite_schema").close()  # opens the write-ahead log, too
        connection.rollback()
        self._files = {}
        self._check()
        return connection

    def _check(self) -> None:
        # SQLite goes on writing to a file that was moved or replaced.
        for path in (self._path, self._path.with_name(self._path.name + "-wal")):
            try:
                status = os.stat(path)
            except OSError as problem:
                raise _gone(path, (problem.strerror or str(problem)).lower()) from None
            found = (status.st_dev, status.st_ino)
            if self._files.setdefault(path, found) != found:
                raise _gone(path, "another file is in its place")


def _gone(path: Path, why: str) -> OperationalError:
    return OperationalError("commit", None, sqlite3.OperationalError(f"file '{path}' is gone: {why}"))


def _set_pragmas(connection: sqlite3.Connection, record: object) -> None:
    for pragma in ("journal_mode=WAL", "synchronous=FULL"):
        connection.execute(f"PRAGMA {pragma}").close()


class ServerDatabase(_Lasting):
    """A schema of PostgreSQL. The writing connection holds an advisory lock, so nobody else writes meanwhile.

    Raises
    ------
    InputError
        where the driver is not installed.
    """

    def __init__(self, url: URL, *, lock: bool) -> None:
        super().__init__()
        self.name = url.render_as_string(hide_password=True)
        given = url.query.get("options", "")
        options = f"{SERVER_OPTIONS} {given if isinstance(given, str) else ' '.join(given)}".strip()
        try:
            self.engine = create_engine(
                url.difference_update_query(["options"]),
                pool_pre_ping=True,
                connect_args={"connect_timeout": 5, "options": options},
            )
        except ImportError:
            raise InputError(
                f"database '{self.name}' needs a driver that is not installed; add thermotrue[postgresql]"
            ) from None
        event.listen(self.engine, "connect", _make_commits_durable)
        self._wants_lock = lock
        if lock:
            self._connection = self._wait()

    def _wait(self) -> Connection:
        end_s = time.monotonic() + LOCK_WAIT_S
        while True:
            try:
                return self._connect()
            except _Taken:
                if time.monotonic() > end_s:
                    self.engine.dispose()
                    raise InputError(
                        f"database '{self.name}' is in use by another service; stop that, or give this one its own"
                    ) from None
            time.sleep(0.1)

    def _connect(self) -> Connection:
        connection = self.engine.connect()
        if self._wants_lock:
            schema = str(connection.execute(text("SELECT current_schema()")).scalar())
            keys = {"first": LOCK_KEY, "second": lock_number(schema)}
            ask = text("SELECT pg_try_advisory_lock(:first, :second)")
            if not connection.execute(ask, keys).scalar():
                connection.close()
                raise _Taken("lock", None, Exception("another service has taken the database"))
            connection.commit()
        return connection


def lock_number(schema: str) -> int:
    """Return the second half of the advisory lock of a schema."""
    return zlib.crc32(schema.encode()) >> 1


class _Taken(OperationalError):
    pass


def _make_commits_durable(connection: Any, record: object) -> None:
    ask = "SELECT set_config('synchronous_commit', 'on', false) WHERE current_setting('synchronous_commit') = 'off'"
    connection.execute(ask)
    connection.commit()
