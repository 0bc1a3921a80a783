"""`/v1/machines/{name}/telemetry`: temperatures in."""

from __future__ import annotations

from fastapi import APIRouter, Request

from service.access.roles import Role, needs
from service.routes.dependencies import NamedMachine, check_samples, header
from service.schemas import TelemetryReply, TelemetryRequest
from service.store.journal import DURABLE_S
from service.store.store import Store
from service.store.unavailable import StorageUnavailable

router = APIRouter(prefix="/v1", tags=["telemetry"])


@router.post("/machines/{name}/telemetry", dependencies=[needs(Role.GATEWAY)])
async def take_telemetry(machine: NamedMachine, request: TelemetryRequest, http: Request) -> TelemetryReply:
    """Take temperature samples, in any order; all or, where one is wrong, none.

    A reading that is missing or implausible is replaced by its estimate from the other sensors, and reported.
    Samples no newer than the thermal state are ignored, and counted.

    The reply means that the samples are stored, and that a restart does not lose them. While the database takes no
    writes, they count for the correction at once all the same, and the answer is 503 with `Retry-After`: send them
    again; those that were stored in the meantime are then counted as ignored.
    """
    check_samples(machine, request.samples, " in samples[{}]")
    receipt = machine.take(request.samples)
    now_s = machine.now()
    reply = TelemetryReply(
        **header(machine, now_s, machine.status(now_s)),
        accepted=receipt.accepted,
        ignored=receipt.ignored,
        warnings=receipt.warnings,
    )
    store: Store = http.app.state.store
    # Ignored ones, too: they may have come before and still wait to be written.
    await store.journal.durable(DURABLE_S)
    if not receipt.recorded:
        raise StorageUnavailable("and too many rows waited for it, so these samples were not queued")
    return reply
