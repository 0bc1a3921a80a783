"""`/healthz`: the process answers. `/readyz`: it can compensate, and forgets nothing."""

from __future__ import annotations

from fastapi import APIRouter, Request

from service.routes.dependencies import loaded_machines
from service.schemas import HealthReply, ReadyReply
from service.store.store import Store
from service.store.unavailable import StorageUnavailable

router = APIRouter(tags=["health"])


@router.get("/healthz")
async def healthz() -> HealthReply:
    """Answer, so that a supervisor knows that the process is alive."""
    return HealthReply(status="ok")


@router.get("/readyz")
async def readyz(request: Request) -> ReadyReply:
    """Answer 200 once all bundles are loaded and while the database takes writes.

    Elsewhere the answer is 503. While the database fails compensation goes on from memory, which a restart would
    lose: let a supervisor restart the service by `/healthz`, and an operator look when this does not answer 200.
    """
    loaded_machines(request)
    store: Store = request.app.state.store
    if store.journal.failure is not None:
        rows = store.journal.queued_rows
        raise StorageUnavailable(
            store.journal.failure, f"compensation goes on from memory, where {rows} rows wait to be written"
        )
    return ReadyReply(status="ready", storage="ok")
