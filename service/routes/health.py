"""`/healthz`: the process answers. `/readyz`: it can compensate."""

from __future__ import annotations

from fastapi import APIRouter, Request

from service.routes.dependencies import loaded_machines
from service.schemas import HealthReply

router = APIRouter(tags=["health"])


@router.get("/healthz")
async def healthz() -> HealthReply:
    """Answer, so that a supervisor knows that the process is alive."""
    return HealthReply(status="ok")


@router.get("/readyz")
async def readyz(request: Request) -> HealthReply:
    """Answer 200 once all bundles are loaded, 503 before."""
    loaded_machines(request)
    return HealthReply(status="ready")
