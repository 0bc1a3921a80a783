"""`/v1/machines/{name}/compensate`: programmed positions in, corrected coordinates out."""

from __future__ import annotations

from itertools import repeat
from typing import Annotated, Any

from fastapi import FastAPI, Query, Response
from pydantic_core import to_json
from starlette.routing import BaseRoute

from model.terms import UM
from model.transforms import Array
from service.access.roles import Role, needs
from service.content_type import ARROW
from service.explain import explain
from service.machine_state import MachineState
from service.outcome import Correction
from service.problems import unprocessable
from service.routes.bulk import correct_stream
from service.routes.by_content_type import route
from service.routes.dependencies import (
    NamedMachine,
    check_samples,
    check_time,
    coordinates,
    header,
)
from service.schemas import (
    MAX_EXPLAINED_PER_REQUEST,
    CompensateQuery,
    CompensateReply,
    CompensateRequest,
    Explanation,
    Sample,
)

PLAIN = CompensateQuery()
_BINARY = {ARROW.decode(): {"schema": {"type": "string", "format": "binary"}}}


def install(app: FastAPI) -> BaseRoute:
    """Add the route before all others, and return it."""
    app.router.add_api_route(
        "/v1/machines/{name}/compensate",
        correct_positions,
        methods=["POST"],
        tags=["compensation"],
        response_model=CompensateReply,
        dependencies=[needs(Role.GATEWAY)],
        responses={200: {"content": _BINARY}},
        openapi_extra={"requestBody": {"content": _BINARY}},
        route_class_override=route({ARROW: correct_stream}),
    )
    app.router.routes.insert(0, app.router.routes.pop())
    return app.router.routes[0]


async def correct_positions(
    machine: NamedMachine, request: CompensateRequest, query: Annotated[CompensateQuery, Query()]
) -> Response:
    """Return the coordinates to command so that the tool tip ends up at the programmed positions.

    Temperatures, where given, count as a telemetry sample first. Where any part of the request is wrong, nothing
    is computed and no sample taken. The sample is stored, too, but the reply does not wait for that: post to
    `telemetry` what must not be lost.

    With `?explain=true` each point says what each error term has to do with its `deviation_um`: its share in the
    workpiece frame, geometric and thermal apart.
    """
    return Response(to_json(corrections(machine, request, query)), media_type="application/json")


def corrections(machine: MachineState, request: CompensateRequest, query: CompensateQuery) -> dict[str, Any]:
    """Return what `CompensateReply` describes; not as that record, since making one takes longer than the correction.

    Raises
    ------
    Problem
        where any part of the request is wrong; nothing is computed then, and no sample taken.
    ComputeError
        where the compensation does not converge.
    """
    if query.tool_length_mm is not None:
        raise unprocessable("key 'tool_length_mm' in the query goes with Arrow streams; name the tool in the body")
    count = len(request.positions)
    if query.explain and count > MAX_EXPLAINED_PER_REQUEST:
        most = MAX_EXPLAINED_PER_REQUEST
        raise unprocessable(f"at most {most} positions can be explained in one request, got {count}; send fewer")
    q = coordinates(machine, request.positions)
    sample = _sample(machine, request)
    warnings: list[str] = []
    if sample is not None:
        check_samples(machine, [sample], "")
        receipt = machine.take([sample])
        if receipt.ignored:
            warnings = receipt.warnings
    elif request.time is not None:
        check_time(machine, request.time, "key 'time'")
    tool_length_mm = None if request.tool is None else request.tool.length_mm
    correction = machine.compensate(q, tool_length_mm, machine.now(request.time))
    return _reply(machine, correction, warnings, _explanations(machine, q, correction) if query.explain else None)


def _sample(machine: MachineState, request: CompensateRequest) -> Sample | None:
    """Return the telemetry sample in the request, if there is one."""
    if request.temperatures is None:
        if request.channels is not None:
            raise unprocessable("key 'channels' must come with 'temperatures', got it alone; give both or neither")
        return None
    time_s = machine.now() if request.time is None else request.time
    return Sample(time=time_s, temperatures=request.temperatures, channels=request.channels or {})


def _explanations(machine: MachineState, q: Array, correction: Correction) -> list[Explanation]:
    geometric = machine.bundle.geometry
    return explain(machine.chain, q, correction.tool_mm, correction.predicted, geometric, correction.deviation_mm)


def _reply(
    machine: MachineState, correction: Correction, warnings: list[str], explanations: list[Explanation] | None
) -> dict[str, Any]:
    outlook = correction.outlook
    axes = machine.machine.axis_names
    count = len(correction.limited)
    rows = zip(
        correction.corrected.tolist(),
        correction.correction_mm.tolist(),
        (correction.deviation_mm / UM).tolist(),
        correction.limited.tolist(),
        repeat(None, count) if correction.uncertainty_um is None else correction.uncertainty_um.tolist(),
        explanations or repeat(None, count),
        strict=True,
    )
    points = []
    for corrected, change, deviation, limited, uncertainty_um, explanation in rows:
        point = {
            "corrected": dict(zip(axes, corrected, strict=True)),
            "correction": dict(zip(axes, change, strict=True)),
            "deviation_um": dict(zip("xyz", deviation, strict=True)),
        }
        if uncertainty_um is not None:
            point["uncertainty_um"] = uncertainty_um
        point["limited"] = limited
        if explanation is not None:
            point["explanation"] = explanation
        points.append(point)
    return {
        **header(machine, outlook.now_s, outlook.status),
        "reliability": outlook.target.weight,
        "warnings": warnings + outlook.warnings,
        "points": points,
    }
