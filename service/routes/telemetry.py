"""`/v1/machines/{name}/telemetry`: temperatures in."""

from __future__ import annotations

from fastapi import APIRouter

from service.routes.dependencies import NamedMachine, check_samples, header
from service.schemas import TelemetryReply, TelemetryRequest

router = APIRouter(prefix="/v1", tags=["telemetry"])


@router.post("/machines/{name}/telemetry")
async def take_telemetry(machine: NamedMachine, request: TelemetryRequest) -> TelemetryReply:
    """Take temperature samples, in any order; all or, where one is wrong, none.

    A reading that is missing or implausible is replaced by its estimate from the other sensors, and reported.
    Samples no newer than the thermal state are ignored, and counted.
    """
    check_samples(machine, request.samples, " in samples[{}]")
    receipt = machine.take(request.samples)
    outlook = machine.outlook(machine.now())
    return TelemetryReply(
        **header(machine, outlook.now_s, outlook.status),
        accepted=receipt.accepted,
        ignored=receipt.ignored,
        warnings=receipt.warnings,
    )
