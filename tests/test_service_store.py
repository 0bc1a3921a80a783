"""The store: migrations, the lock against a second service, and what a wrong database gets told."""

import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import create_engine, text
from store_databases import database

from model.exceptions import InputError
from service.store import audit, schema
from service.store.store import Store, open_store
from service.store.tables import metadata


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    with database(request.param, tmp_path) as found:
        yield found


def test_migrations_lead_to_the_tables(url: str) -> None:
    with open_store(url) as store, store.engine.connect() as connection:
        options = {"compare_type": True, "compare_server_default": True, "version_table": schema.VERSION_TABLE}
        context = MigrationContext.configure(connection, opts=options)
        assert compare_metadata(context, metadata) == []
        assert store.new
    with open_store(url) as store, store.engine.connect() as connection:  # and there is nothing left to migrate
        assert schema.version_of(connection) == schema.HEAD
        assert not store.new


def test_the_newest_migration_is_the_one_named() -> None:
    found = sorted(p.name.split("_")[0] for p in (schema.MIGRATIONS / "versions").glob("[0-9]*.py"))
    assert found[-1] == schema.HEAD


def test_a_migration_that_is_interrupted_leaves_nothing(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(connection: object) -> None:
        upgrade(connection)
        raise KeyboardInterrupt

    upgrade = schema._upgrade
    monkeypatch.setattr(schema, "_upgrade", interrupted)
    with pytest.raises(KeyboardInterrupt):
        open_store(url, lock=False)
    monkeypatch.undo()
    with open_store(url) as store:
        assert audit.entries(store.engine, "m", 10) == []


def test_a_second_service_is_refused_and_commands_are_not(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.store.database.LOCK_WAIT_S", 0.2)
    with open_store(url):
        with pytest.raises(InputError, match=r"database '.*' is in use by another service; stop that"):
            open_store(url)
        with open_store(url, lock=False) as beside, beside.engine.begin() as connection:
            audit.record("me", "looked", None)(connection)
    with open_store(url) as store:
        assert [e["action"] for e in audit.entries(store.engine, "m", 10)] == ["looked"]


def test_the_lock_ends_with_its_process_however_that_ends(url: str) -> None:
    opens = "from service.store.store import open_store; store = open_store(sys.argv[1])"
    code = f"import os, sys; {opens}; os.kill(os.getpid(), 9)"
    assert subprocess.run([sys.executable, "-c", code, url], check=False).returncode == -9
    open_store(url).close()


def test_a_newer_schema_is_refused_in_one_sentence(url: str) -> None:
    with open_store(url) as store, store.engine.begin() as connection:
        connection.execute(text(f"UPDATE {schema.VERSION_TABLE} SET version_num = '9999'"))  # noqa: S608
    with pytest.raises(
        InputError, match=r"database '.*' must be of this release of thermotrue or an older one, got ver"
    ):
        open_store(url)


def test_another_programs_database_is_refused(url: str) -> None:
    engine = create_engine(url.replace("postgresql:", "postgresql+psycopg:"))
    with engine.begin() as connection:
        connection.execute(text("CREATE TABLE models (x INTEGER)"))
    engine.dispose()
    with pytest.raises(InputError, match=r"database '.*' must be empty or thermotrue's, and has tables models of"):
        open_store(url)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ("no url", "database must be sqlite:///FILE or postgresql://USER@HOST/NAME, got text that is not a URL"),
        (
            "mysql://u:hush@h/n",
            "database must be sqlite:///FILE or postgresql://USER@HOST/NAME, got 'mysql://u:***@h/n'",
        ),
        ("sqlite:////proc/none/t.db", "database '/proc/none/t.db' must be a file that can be written to: No such file"),
        (
            "postgresql://u:hush@127.0.0.1:1/n",
            "database 'postgresql://u:***@127.0.0.1:1/n' must be one that can be opened, and is not: connection",
        ),
    ],
)
def test_a_wrong_url_gets_one_sentence_without_the_password(wrong: str, sentence: str) -> None:
    with pytest.raises(InputError) as problem:
        open_store(wrong)
    assert str(problem.value).startswith(sentence)
    assert "hush" not in str(problem.value)
    assert "\n" not in str(problem.value)


def test_a_file_that_is_no_database_gets_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "thermotrue.db"
    path.write_bytes(b"my dissertation " * 1000)
    with pytest.raises(
        InputError, match=r"database '.*' must be one that can be opened, and is not: file is not a data"
    ):
        open_store(f"sqlite:///{path}")
    assert path.read_bytes() == b"my dissertation " * 1000


def test_a_commit_is_on_the_disk(tmp_path: Path) -> None:
    """The settings on which durability rests, as the connection that writes has them."""
    with open_store(f"sqlite:///{tmp_path / 't.db'}") as store, store.engine.connect() as connection:
        values = {p: connection.exec_driver_sql(f"PRAGMA {p}").scalar() for p in ("journal_mode", "synchronous")}
    assert values == {"journal_mode": "wal", "synchronous": 2}
    assert sqlite3.connect(tmp_path / "t.db").execute("PRAGMA journal_mode").fetchone() == ("wal",)
    with database("postgresql", tmp_path) as url:
        lazy = f"{url}%20-csynchronous_commit%3Doff"
        with open_store(lazy) as store, store.engine.connect() as connection:
            assert connection.execute(text("SHOW synchronous_commit")).scalar() == "on"


def test_memory_is_another_one_each_time() -> None:
    with open_store("sqlite://") as one, open_store("sqlite://") as other:
        with one.engine.begin() as connection:
            audit.record("me", "looked", None)(connection)
        assert _count(one) == 1
        assert _count(other) == 0
        assert not one.lasting


def _count(store: Store) -> int:
    return len(audit.entries(store.engine, "m", 10))
