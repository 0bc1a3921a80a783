"""What the service does beside requests: snapshots that are due, old rows, and a look whether the database works."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager

from sqlalchemy import ColumnElement, Connection, Table, select

from service.machine_state import MachineState
from service.settings import Settings
from service.store.store import Store
from service.store.tables import audit, measurements, snapshots, telemetry

log = logging.getLogger(__name__)

TICK_S = 1.0
FIRST_PRUNE_S = 60.0
PRUNE_EVERY_S = 3600.0
PRUNE_ROWS = 2000
"""Rows removed in one transaction, so that telemetry never waits for long."""
PRUNE_PAUSE_S = 0.2
LOOK_EVERY = 10
"""Ticks after which an idle database is written to, so that its failure shows before it is needed."""
DAY_S = 86400.0
KEEP_MEASUREMENTS_DAYS = 365.0
KEEP_AUDIT_DAYS = 5 * 365.0


@asynccontextmanager
async def kept(
    machines: Mapping[str, MachineState], store: Store, settings: Settings, clock: Callable[[], float]
) -> AsyncIterator[None]:
    """Do what is due meanwhile; at the end take a last snapshot of each machine."""
    tasks = [asyncio.create_task(_watch(machines, store)), asyncio.create_task(_tidy(store, settings, clock))]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for state in machines.values():
            if state.recorder is not None:
                state.recorder.snapshot(state, last=True)


async def _watch(machines: Mapping[str, MachineState], store: Store) -> None:
    """Take snapshots that are due, and look whether the database works."""
    ticks = 0
    while True:
        await asyncio.sleep(TICK_S)
        ticks += 1
        try:
            for state in list(machines.values()):
                if state.recorder is not None:
                    state.recorder.tick(state)
                await asyncio.sleep(0)  # corrections do not wait until all machines are through
            if ticks % LOOK_EVERY == 0:
                store.journal.write_latest("look", lambda connection: None)
        except Exception:
            log.exception("no snapshots were taken; tried again in a second")


async def _tidy(store: Store, settings: Settings, clock: Callable[[], float]) -> None:
    """Remove what is too old, every hour."""
    pause_s = FIRST_PRUNE_S
    while store.lasting:
        await asyncio.sleep(pause_s)
        pause_s = PRUNE_EVERY_S
        try:
            await prune(store, settings.telemetry_keep_days, clock())
        except Exception:
            log.exception("old rows were not removed; tried again in an hour")


async def prune(store: Store, keep_days: float, now_s: float) -> int:
    """Remove what is too old, in small steps; returns how many rows.

    Telemetry counts as old from the machine's newest snapshot on, which has all that is before it: a clock that jumps
    ahead removes nothing that a restart needs.
    """
    total = 0
    newest = await asyncio.to_thread(_newest_snapshots, store)
    for machine, time_s in newest.items():
        before_s = min(now_s, time_s) - keep_days * DAY_S
        total += await _remove(store, telemetry, (telemetry.c.machine == machine) & (telemetry.c.time_s < before_s))
    for table, days in ((measurements, KEEP_MEASUREMENTS_DAYS), (audit, KEEP_AUDIT_DAYS)):
        total += await _remove(store, table, table.c.time_s < now_s - days * DAY_S)
    if total:
        log.info("old rows removed", extra={"rows": total})
    return total


def _newest_snapshots(store: Store) -> dict[str, float]:
    with store.engine.connect() as connection:
        rows = connection.execute(select(snapshots.c.machine, snapshots.c.time_s)).all()
    return {machine: time_s for machine, time_s in rows if time_s is not None}


async def _remove(store: Store, table: Table, old: ColumnElement[bool]) -> int:
    total = 0
    while True:
        removed: list[int] = []

        def step(connection: Connection, removed: list[int] = removed) -> None:
            some = select(table.c.id).where(old).limit(PRUNE_ROWS)
            removed[:] = [connection.execute(table.delete().where(table.c.id.in_(some))).rowcount]

        await store.journal.write(step)
        total += removed[0]
        if removed[0] < PRUNE_ROWS:
            return total
        await asyncio.sleep(PRUNE_PAUSE_S)
