"""The audit trail: what was changed, when and by whom."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from typing import Any

from sqlalchemy import Engine, select

from service.store.journal import Insert
from service.store.tables import audit


def record(who: str, action: str, machine: str | None, detail: Mapping[str, Any] | None = None) -> Insert:
    """Return an operation for the journal that adds an entry, with the present time.

    Parameters
    ----------
    who : name of the key, 'anyone' without keys, or 'service'
    action : what was done, such as 'datum set'
    machine : None where it concerns all
    detail : what JSON can take
    """
    row = {
        "time_s": time.time(),
        "who": who,
        "machine": machine,
        "action": action,
        "detail": json.dumps(dict(detail or {})),
    }
    return Insert(audit, [row])


def entries(engine: Engine, machine: str, limit: int) -> list[dict[str, Any]]:
    """Return the newest entries of a machine and of the whole service, newest first."""
    wanted = (
        select(audit)
        .where((audit.c.machine == machine) | audit.c.machine.is_(None))
        .order_by(audit.c.time_s.desc(), audit.c.id.desc())
        .limit(limit)
    )
    with engine.connect() as connection:
        return [{**row, "detail": json.loads(row["detail"])} for row in connection.execute(wanted).mappings()]
