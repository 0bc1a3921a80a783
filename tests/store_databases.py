"""Databases for tests: files of SQLite, and schemas of their own in a real PostgreSQL."""

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psycopg
import pytest

POSTGRESQL = os.environ.get("THERMOTRUE_TEST_POSTGRESQL", "postgresql://root@127.0.0.1:5432/test")


@contextmanager
def schema() -> Iterator[str]:
    """Yield the URL of an empty schema, which nobody else has."""
    name = f"thermotrue_{uuid.uuid4().hex[:12]}"
    try:
        with psycopg.connect(POSTGRESQL, autocommit=True, connect_timeout=5) as connection:
            connection.execute(f'CREATE SCHEMA "{name}"')
    except psycopg.OperationalError as problem:
        pytest.fail(
            f"these tests need PostgreSQL at {POSTGRESQL}: {problem}; start it (`tests/start_postgresql.sh`, or "
            "`docker run -e POSTGRES_HOST_AUTH_METHOD=trust -p 5432:5432 postgres`) or name another by the environment "
            "variable THERMOTRUE_TEST_POSTGRESQL"
        )
    try:
        yield f"{POSTGRESQL}?options=-csearch_path%3D{name}"
    finally:
        with psycopg.connect(POSTGRESQL, autocommit=True) as connection:
            connection.execute(f'DROP SCHEMA "{name}" CASCADE')


@contextmanager
def database(kind: str, folder: Path) -> Iterator[str]:
    """Yield the URL of an empty database: 'sqlite' or 'postgresql'."""
    if kind == "sqlite":
        yield f"sqlite:///{folder / 'thermotrue.db'}"
        return
    with schema() as url:
        yield url
