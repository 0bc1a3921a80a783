"""The store: a database at this release's tables, its journal, and the lock that keeps a second service out."""

from __future__ import annotations

from contextlib import suppress
from types import TracebackType

from sqlalchemy import Engine
from sqlalchemy.engine import make_url
from sqlalchemy.exc import SQLAlchemyError

from model.exceptions import InputError
from service.store import schema
from service.store.database import Database, MemoryDatabase, open_database
from service.store.journal import Journal, reason
from service.store.tables import metadata


class Store:
    """An open database.

    Attributes
    ----------
    engine : for reads, in a thread: `with store.engine.connect() as connection`
    journal : for writes
    name : of the database, without a password
    lasting : whether it outlives the process
    new : whether it was made now, so that nothing from before is known
    """

    def __init__(self, database: Database, *, new: bool) -> None:
        self._database = database
        self.new = new
        self.engine: Engine = database.engine
        self.name, self.lasting = database.name, database.lasting
        self.journal = Journal(database)

    def close(self) -> None:
        """Write what is queued, end the journal's thread and give the lock back."""
        self.journal.close()
        self._database.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_store(url: str, *, lock: bool = True) -> Store:
    """Open a database, and bring it to this release's tables.

    Parameters
    ----------
    url : `sqlite:///FILE`, `postgresql://USER@HOST/NAME`, or `sqlite://` for memory
    lock : keep other services out; commands that run beside a service do without

    Raises
    ------
    InputError
        where it cannot be opened, another service runs on it, or it is of a newer release.
    """
    try:
        database = open_database(url, lock=lock)
    except SQLAlchemyError as problem:
        raise _cannot(url_name(url), problem) from None
    try:
        if isinstance(database, MemoryDatabase):
            metadata.create_all(database.engine)
            return Store(database, new=True)
        with database.engine.connect() as connection:
            version = schema.version_of(connection)
        if version != schema.HEAD:
            _migrate(database, url, lock=lock)
        return Store(database, new=version is None)
    except BaseException as problem:
        with suppress(SQLAlchemyError):
            database.close()
        if isinstance(problem, SQLAlchemyError):
            raise _cannot(database.name, problem) from None
        raise


def url_name(url: str) -> str:
    """Return a database's URL without its password."""
    return make_url(url).render_as_string(hide_password=True)


def _migrate(database: Database, url: str, *, lock: bool) -> None:
    if lock:
        with database.engine.connect() as connection:
            schema.migrate(connection, database.name)
        return
    # Not under a service that runs on it: it may be of another release.
    with_lock = open_database(url, lock=True)
    try:
        _migrate(with_lock, url, lock=True)
    finally:
        with_lock.close()


def _cannot(name: str, problem: SQLAlchemyError) -> InputError:
    return InputError(f"database '{name}' must be one that can be opened, and is not: {reason(problem)}")
