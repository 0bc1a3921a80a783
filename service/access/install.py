"""Put the gate and the limits around an app."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress

from fastapi import FastAPI

from service.access.gate import Gate
from service.access.keyring import KeyRing
from service.body_limit import BodyLimit
from service.overload import Overload, Turns
from service.rate_limit import RateLimit
from service.settings import Settings
from service.store.store import Store


def install(app: FastAPI, store: Store, settings: Settings) -> None:
    """Ask every request who calls, then whether it is too many, too much or too long.

    `app.state.key_ring` has to be `refreshed` while the app runs; `app.state.turns` paces what computes.
    """
    app.state.key_ring = KeyRing(store, settings)
    app.state.turns = Turns()
    # The one added last is asked first.
    app.add_middleware(BodyLimit)
    app.add_middleware(
        Overload, most=settings.max_in_work, most_first=settings.max_telemetry_in_work, turns=app.state.turns
    )
    app.add_middleware(RateLimit, per_s=settings.max_requests_per_s)
    app.add_middleware(Gate, ring=app.state.key_ring)


@asynccontextmanager
async def refreshed(ring: KeyRing) -> AsyncGenerator[None]:
    """Keep the keys as the database has them."""
    task = asyncio.create_task(ring.refresh())
    try:
        yield
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
