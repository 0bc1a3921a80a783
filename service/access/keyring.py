"""All keys, in memory: read from the database every second, so that no request waits for it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable

from sqlalchemy import Engine

from service.access.key_table import records
from service.access.keys import Record, holder
from service.access.roles import ANYONE, Caller
from service.settings import Settings, is_loopback
from service.store.store import Store

log = logging.getLogger(__name__)

REFRESH_S = 1.0
"""How soon a key made or revoked elsewhere counts here [s]."""


class KeyRing:
    """The keys that open this service, and whether any is needed.

    While the database is away, the keys read last go on: a machine does not lose its correction over it.

    Attributes
    ----------
    required : whether callers must show a key
    """

    def __init__(self, store: Store, settings: Settings) -> None:
        self._engine, self._settings = store.engine, settings
        self._lasting = store.lasting
        self._records: dict[str, Record] = {}
        self.required = settings.keys == "required" or (settings.keys == "auto" and not is_loopback(settings.host))
        self._take(_read(self._engine))

    def caller(self, key: str) -> Caller | None:
        """Return whose key that is; None where nobody's, or where it was revoked."""
        return holder(key, self._records)

    def anyone(self) -> Caller | None:
        """Return who calls without a key; None where a key is needed."""
        return None if self.required else ANYONE

    def lets_in(self, caller: Caller) -> bool:
        """Return whether a caller that was let in earlier would still be: what stays open asks from time to time."""
        if caller.key_id is None:
            return not self.required
        record = self._records.get(caller.key_id)
        return record is not None and record.revoked_s is None

    async def refresh(self, pause: Callable[[float], Awaitable[None]] = asyncio.sleep) -> None:
        """Read the keys again and again, until cancelled; nobody else can change those of a database in memory."""
        failing = False
        while self._lasting:
            await pause(REFRESH_S)
            try:
                self._take(await asyncio.to_thread(_read, self._engine))
                failing = False
            except Exception as problem:  # whatever it is, revoking must work again once it is over
                if not failing:
                    log.warning("keys cannot be read; those read last go on", extra={"reason": type(problem).__name__})
                failing = True

    def _take(self, found: list[Record]) -> None:
        self._records = {record.id: record for record in found}
        # Keys that were all revoked still count, and so do those of a database that has lost them meanwhile: what
        # was closed once does not open by itself.
        self.required = self.required or (self._settings.keys == "auto" and bool(found))


def _read(engine: Engine) -> list[Record]:
    with engine.connect() as connection:
        return records(connection)
