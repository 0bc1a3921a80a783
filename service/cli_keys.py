"""`thermotrue keys`: who may call the service."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from sqlalchemy import Connection

    from service.access.keys import Record

Command = TypeVar("Command", bound=Callable[..., Any])


def _where(command: Command) -> Command:
    """Add the options that say in which database the keys are: the service's."""
    for add in (
        click.option("--config", type=click.Path(path_type=Path), help="The service's settings file."),
        click.option("--data-dir", type=click.Path(path_type=Path), help="The service's data directory."),
        click.option("--database", help="The service's database, where it has one of its own."),
    ):
        command = add(command)
    return command


@click.group()
def keys() -> None:
    """Make, list and revoke the keys that callers of the service show.

    The service may run meanwhile: it looks for changes every second. Its database is found as the service itself finds
    it: by options, by the environment (THERMOTRUE_DATA_DIR, THERMOTRUE_DATABASE), in a settings file, or by default.
    """


@keys.command()
@click.argument("name")
@click.option(
    "--role", required=True, help="viewer reads, gateway asks and reports as well, admin changes models, too."
)
@click.option("--json", "as_json", is_flag=True, help="Print the key and what is known of it as JSON.")
@_where
def create(name: str, role: str, *, as_json: bool, **where: Any) -> None:
    """Make a key, and print it: once, for it is stored nowhere.

    Callers send it in the header `Authorization: Bearer KEY`.
    """
    import json
    import time

    from model.exceptions import InputError
    from service.access import key_table
    from service.access.roles import Role

    roles = [str(r) for r in Role]
    if role not in roles:
        raise InputError(f"--role must be one of {', '.join(roles)}, got '{role}'")
    with _database(where) as connection:
        key, record = key_table.create(connection, name, Role(role), time.time())
    if as_json:
        click.echo(json.dumps({"key": key} | _public(record)))
        return
    # The key alone goes to stdout, so that KEY=$(thermotrue keys create ...) has it.
    click.echo(key)
    click.echo(f"keep it: it is not shown again; id {record.id}, role {record.role}", err=True)


@keys.command("list")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@_where
def list_keys(*, as_json: bool, **where: Any) -> None:
    """List all keys without their secrets, revoked ones included."""
    import json

    from service.access import key_table

    with _database(where) as connection:
        rows = [_public(record) for record in key_table.records(connection)]
    if as_json:
        click.echo(json.dumps(rows))
        return
    columns = ("id", "name", "role", "created", "revoked")
    table = [columns, *(tuple(row[c] or "" for c in columns) for row in rows)]
    widths = [max(len(line[i]) for line in table) for i in range(len(columns))]
    for line in table:
        click.echo("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


@keys.command()
@click.argument("key", metavar="ID|NAME")
@_where
def revoke(key: str, **where: Any) -> None:
    """Revoke a key: within five seconds a running service refuses it."""
    import time

    from service.access import key_table

    with _database(where) as connection:
        record = key_table.revoke(connection, key, time.time())
    click.echo(f"revoked {record.id}, '{record.name}'")


def _public(record: Record) -> dict[str, str | None]:
    """Return what may be told of a key."""
    from service.timestamps import format_time

    return {
        "id": record.id,
        "name": record.name,
        "role": str(record.role),
        "created": format_time(record.created_s),
        "revoked": None if record.revoked_s is None else format_time(record.revoked_s),
    }


@contextmanager
def _database(where: dict[str, Any]) -> Generator[Connection]:
    """Open the service's database, also while the service runs; what was done is kept where nothing is raised."""
    from contextlib import closing

    from model.exceptions import InputError
    from service.settings import read_settings
    from service.store.store import open_store

    config = where.pop("config")
    settings = read_settings(config, **{name: value for name, value in where.items() if value is not None})
    with closing(open_store(settings.database_url, lock=False)) as store:
        if not store.lasting:
            raise InputError("keys must be kept in a database that lasts, got one in memory; name it by --database")
        with store.engine.begin() as connection:
            yield connection
