"""Keys in the database: made, listed and revoked, each change with its row in the audit trail."""

from __future__ import annotations

import getpass
import re

from sqlalchemy import Connection, insert, select, update

from model.exceptions import InputError
from model.validation import did_you_mean
from service.access.keys import Record, new_key
from service.access.roles import Role
from service.store import audit
from service.store.tables import keys

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._ -]{0,63}")


def create(connection: Connection, name: str, role: Role, now_s: float) -> tuple[str, Record]:
    """Store a new key, and return it with its record; nobody can read it again later.

    Raises
    ------
    InputError
        where the name is not fit for logs, or a key in force has it.
    """
    if not _NAME.fullmatch(name):
        raise InputError(f"a key's name must be up to 64 letters, digits, spaces and ._-, got '{name[:80]}'")
    if any(record.name == name for record in records(connection) if record.revoked_s is None):
        raise InputError(f"a key's name must be its own, and '{name}' is in use; revoke that key, or take another name")
    key, record = new_key(name, role, now_s)
    connection.execute(
        insert(keys).values(id=record.id, name=name, role=str(role), hash=record.hash, created_s=now_s, revoked_s=None)
    )
    audit.record(who(), "key created", None, {"id": record.id, "name": name, "role": str(role)})(connection)
    return key, record


def records(connection: Connection) -> list[Record]:
    """Return all keys, the oldest first, revoked ones included."""
    rows = connection.execute(select(keys).order_by(keys.c.created_s, keys.c.id)).all()
    known = {str(role) for role in Role}
    # A role that a later release has made opens nothing here.
    return [
        Record(row.id, row.name, Role(row.role), row.hash, row.created_s, row.revoked_s)
        for row in rows
        if row.role in known
    ]


def revoke(connection: Connection, which: str, now_s: float) -> Record:
    """Revoke the key in force with that id or name, and return its record.

    Raises
    ------
    InputError
        where there is none.
    """
    live = [record for record in records(connection) if record.revoked_s is None]
    found = [record for record in live if which in (record.id, record.name)]
    if not found:
        hint = did_you_mean(which, [record.name for record in live])
        raise InputError(f"there is no key in force with the id or name '{which[:80]}'{hint}")
    [record] = found
    connection.execute(update(keys).where(keys.c.id == record.id).values(revoked_s=now_s))
    audit.record(who(), "key revoked", None, {"id": record.id, "name": record.name})(connection)
    return record


def who() -> str:
    """Return who changes keys, for the audit trail: this computer's user."""
    try:
        return f"{getpass.getuser()} (command line)"[:64]
    except (KeyError, OSError):  # a container's user has a number and no name
        return "command line"
