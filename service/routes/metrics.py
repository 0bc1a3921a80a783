"""`/metrics`: for Prometheus."""

from __future__ import annotations

import asyncio

from fastapi import APIRouter, Request
from prometheus_client import CONTENT_TYPE_LATEST
from prometheus_client.exposition import choose_encoder
from starlette.responses import Response

from service.machine_metrics import Snapshot
from service.machine_state import MachineState
from service.metrics import Metrics

EXAMPLE = """\
# HELP thermotrue_correction_um Largest correction, at corners and middle.
# TYPE thermotrue_correction_um gauge
thermotrue_correction_um{machine="vmc3"} 62.9
"""
router = APIRouter(tags=["health"])


@router.get(
    "/metrics",
    response_class=Response,
    responses={
        200: {
            "description": "Prometheus' text format, or OpenMetrics where it is asked for.",
            "content": {CONTENT_TYPE_LATEST: {"schema": {"type": "string"}, "example": EXAMPLE}},
        }
    },
)
async def show_metrics(request: Request) -> Response:
    """Show metrics for Prometheus: requests, and each machine's status, correction, sensors, telemetry and counts."""
    metrics: Metrics = request.app.state.metrics
    states: dict[str, MachineState] = getattr(request.app.state, "machines", None) or {}
    snapshots = []
    for state in states.values():
        snapshots.append(Snapshot.of(state))
        await asyncio.sleep(0)  # corrections do not wait until all machines are through
    metrics.machines.snapshots = snapshots
    encode, content_type = choose_encoder(request.headers.get("accept", ""))
    text = await asyncio.to_thread(encode, metrics.registry)
    return Response(text, headers={"content-type": content_type})
