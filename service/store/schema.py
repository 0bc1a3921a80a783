"""Bring a database to the tables of this release, or say why it cannot be."""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import Connection, inspect, text

from model.exceptions import InputError
from service.store.tables import metadata

HEAD = "0001"
"""The newest migration; `migrations/versions` has them all."""
VERSION_TABLE = "thermotrue_version"
"""Alembic's table, under a name of our own, since other programs may keep theirs in the same database."""
MIGRATIONS = Path(__file__).parent / "migrations"


def version_of(connection: Connection) -> str | None:
    """Return which migration a database is at; None for one without our tables."""
    if not inspect(connection).has_table(VERSION_TABLE):
        return None
    found = connection.execute(text(f"SELECT version_num FROM {VERSION_TABLE}")).scalar()  # noqa: S608 (a constant)
    return None if found is None else str(found)


def migrate(connection: Connection, name: str) -> None:
    """Bring a database to the tables of this release.

    Parameters
    ----------
    name : of the database, for messages

    Raises
    ------
    InputError
        where it is of a newer release, or has tables of the same names that are not thermotrue's.
    """
    if connection.dialect.name == "sqlite":
        # Otherwise the driver commits each statement, and an interrupted migration could not be run again.
        connection.exec_driver_sql("BEGIN IMMEDIATE")
    version = version_of(connection)
    if version == HEAD:
        connection.rollback()
        return
    if version is None:
        foreign = sorted(set(inspect(connection).get_table_names()) & set(metadata.tables))
        if foreign:
            raise InputError(
                f"database '{name}' must be empty or thermotrue's, and has tables {', '.join(foreign)} of another "
                "program; name another one"
            )
    elif not list((MIGRATIONS / "versions").glob(f"{version}_*.py")):
        raise InputError(
            f"database '{name}' must be of this release of thermotrue or an older one, got version {version}, and "
            f"this release knows {HEAD}; install the newer release again"
        )
    _upgrade(connection)
    connection.commit()


def _upgrade(connection: Connection) -> None:
    from alembic import command  # noqa: PLC0415 (a quarter of a second, and most starts have nothing to migrate)
    from alembic.config import Config  # noqa: PLC0415

    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    config.attributes["connection"] = connection
    command.upgrade(config, "head")
