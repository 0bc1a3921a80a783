"""The models that the database holds: rows and files, and the operations that change them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from sqlalchemy import Connection, Engine, Row, func, select

from model.bundle import MANIFEST
from service.store.tables import model_files, models

Operation = Callable[[Connection], None]
CLOCK_STEP_S = 1e-3
"""Between two activations at least [s]: what a double holds of an epoch time, with room."""
Origin = Literal["command-line", "upload"]


@dataclass(frozen=True)
class Stored:
    """A model in the database.

    Attributes
    ----------
    added_s, added_by : when and by whom
    activated_s : when it became active last, epoch seconds; None where it never was
    active : whether it is what the machine is served with, or will be after a restart
    """

    machine: str
    version: str
    origin: Origin
    added_s: float
    added_by: str
    active: bool
    activated_s: float | None


def stored_models(engine: Engine, machine: str | None = None) -> list[Stored]:
    """Return a machine's models, or those of all, newest first."""
    wanted = select(models).order_by(models.c.added_s.desc(), models.c.version)
    if machine is not None:
        wanted = wanted.where(models.c.machine == machine)
    with engine.connect() as connection:
        return [_stored(row) for row in connection.execute(wanted)]


def stored_files(engine: Engine, machine: str, version: str) -> dict[str, bytes]:
    """Return a model's files by name; none where they were never stored."""
    wanted = select(model_files.c.name, model_files.c.content).where(
        model_files.c.machine == machine, model_files.c.version == version
    )
    with engine.connect() as connection:
        return {row.name: bytes(row.content) for row in connection.execute(wanted)}


def summaries(engine: Engine, machine: str) -> dict[str, dict[str, Any]]:
    """Return of each version what its manifest says of its training and its test."""
    wanted = select(model_files.c.version, model_files.c.content).where(
        model_files.c.machine == machine, model_files.c.name == MANIFEST
    )
    found: dict[str, dict[str, Any]] = {}
    with engine.connect() as connection:
        for row in connection.execute(wanted):
            manifest = json.loads(bytes(row.content))  # verified before it was stored
            found[row.version] = {what: manifest.get(what) or {} for what in ("training", "test")}
    return found


def with_files(engine: Engine) -> set[tuple[str, str]]:
    """Return machine and version of the models whose files are stored."""
    with engine.connect() as connection:
        rows = connection.execute(select(model_files.c.machine, model_files.c.version).distinct())
        return {(row.machine, row.version) for row in rows}


def add(row: Stored) -> Operation:
    """Return the operation that stores a model's row, unless it is there."""

    def operation(connection: Connection) -> None:
        key = {"machine": row.machine, "version": row.version}
        if connection.execute(select(models.c.version).filter_by(**key)).first() is None:
            values = {"origin": row.origin, "added_s": row.added_s, "added_by": row.added_by}
            connection.execute(models.insert(), {**key, **values, "active": False, "activated_s": None})

    return operation


def add_files(machine: str, version: str, files: Callable[[], Mapping[str, bytes]]) -> Operation:
    """Return the operation that stores the files of a model, unless they are there or it has gone meanwhile.

    `files` is called when that happens.
    """

    def operation(connection: Connection) -> None:
        key = {"machine": machine, "version": version}
        if connection.execute(select(models.c.version).filter_by(**key)).first() is None:
            return
        if connection.execute(select(model_files.c.name).filter_by(**key)).first() is None:
            rows = [{**key, "name": name, "content": content} for name, content in files().items()]
            if rows:
                connection.execute(model_files.insert(), rows)

    return operation


def activate(machine: str, version: str, now_s: float) -> Operation:
    """Return the operation that makes a stored model the active one of its machine."""

    def operation(connection: Connection) -> None:
        of_machine = models.update().where(models.c.machine == machine)
        newest = select(func.max(models.c.activated_s)).where(models.c.machine == machine)
        # What was active before is found by these times, so they must rise, whatever the clock does.
        later_s = max(now_s, (connection.execute(newest).scalar() or 0.0) + CLOCK_STEP_S)
        connection.execute(of_machine.where(models.c.active).values(active=False))
        connection.execute(of_machine.where(models.c.version == version).values(active=True, activated_s=later_s))

    return operation


def remove(machine: str, version: str) -> Operation:
    """Return the operation that deletes a model, unless it is active."""

    def operation(connection: Connection) -> None:
        key = (models.c.machine == machine) & (models.c.version == version)
        if connection.execute(models.delete().where(key & ~models.c.active)).rowcount:
            files = (model_files.c.machine == machine) & (model_files.c.version == version)
            connection.execute(model_files.delete().where(files))

    return operation


def _stored(row: Row[Any]) -> Stored:
    return Stored(**row._mapping)
