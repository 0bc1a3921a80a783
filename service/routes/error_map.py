"""`/v1/machines/{name}/map`: the error map, for a controller that compensates by itself."""

from __future__ import annotations

import hashlib
from typing import Annotated, Any

from fastapi import APIRouter, Header, Query, Response

from model.error_map import ErrorMap
from model.structure import Body
from model.terms import DIRECTIONS
from service.access.roles import Role, needs
from service.machine_state import MachineState
from service.map_schemas import AxisGeometry, BodyInfo, ErrorTables, MapQuery, MapReply, ToolInfo
from service.outcome import Outlook
from service.routes.datum import datum_of
from service.routes.dependencies import NamedMachine, check_time, header
from service.safety import Served
from service.schemas import LimitsInfo
from service.timestamps import LATEST_S, format_time

router = APIRouter(prefix="/v1", tags=["errors"])

_ETAG = {"ETag": {"description": "The map's version, weak.", "schema": {"type": "string"}}}


@router.get(
    "/machines/{name}/map",
    response_model=MapReply,
    dependencies=[needs(Role.GATEWAY)],
    responses={
        200: {"headers": _ETAG},
        304: {"description": "The map is still the one whose ETag came in If-None-Match.", "headers": _ETAG},
    },
)
async def show_map(
    machine: NamedMachine,
    query: Annotated[MapQuery, Query()],
    response: Response,
    if_none_match: Annotated[str | None, Header(description="ETag of the map at hand; the same answers 304.")] = None,
) -> MapReply | Response:
    """Show the error map that corrections are computed from just now: all that a client needs to compensate by itself.

    How to use it:

    1. Look up each motion term of `served` at its axis' coordinate: linear between `knots_mm`, constant beyond them.
    2. A body's frame in its lower body's frame is `Trans(origin_mm) · ΔF · Trans(coordinate · direction) · ΔM`, or, for
       the composition "seed", `Trans(origin_mm) · Trans(coordinate · direction) · ΔF · ΔM`. ΔM is made of the body's
       motion terms, ΔF of its location terms, each as `Trans(x, y, z) · Rx(a) · Ry(b) · Rz(c)`, in mm and rad.
    3. The tool tip in the workpiece frame follows from the frames of `workpiece_body` and `tool.body` in the bed's:
       `inverse(workpiece) · tool · tip`.
    4. Find the coordinates for which that tip is where the programmed ones have it without errors, and let no axis go
       further from the programmed coordinate than `max_correction_um`.

    The answers are those of `compensate`. A fetched map counts as served, so the rate limit holds from one to the next:
    at 60 µm/min, one fetched every ten seconds moves the correction by at most 10 µm.
    """
    if query.time is not None:
        check_time(machine, query.time, "key 'time' in the query")
    outlook, served = machine.hand_out(query.tool_length_mm, machine.now(query.time))
    reply = _reply(machine, outlook, served)
    headers = {"ETag": f'W/"{reply.version}"', "Cache-Control": "private, no-cache"}
    if if_none_match is not None and _names(if_none_match, reply.version):
        return Response(status_code=304, headers=headers)
    response.headers.update(headers)
    return reply


def _names(if_none_match: str, version: str) -> bool:
    """Return whether the header's list of ETags has that version in it, weak or strong."""
    tags = [tag.strip().removeprefix("W/") for tag in if_none_match.split(",")]
    return "*" in tags or f'"{version}"' in tags


def _reply(state: MachineState, outlook: Outlook, served: Served) -> MapReply:
    machine = state.machine
    layout, limits = machine.layout, machine.limits
    target = outlook.target
    moving = target.usable and not served.arrived
    reply = MapReply(
        **header(state, outlook.now_s, outlook.status),
        warnings=outlook.warnings,
        version="",
        valid_until=_valid_until(state),
        datum=datum_of(state),
        composition=machine.composition,
        structure=[_body(state, index, body) for index, body in enumerate(machine.bodies)],
        workpiece_body=machine.bodies[layout.workpiece].name,
        tool=ToolInfo(
            body=machine.bodies[layout.tools[state.chain.tool]].name,
            offset_mm=machine.tool.offset_mm,
            direction=machine.tool.direction,
        ),
        axes={
            name: AxisGeometry(range_mm=(axis.low, axis.high), origin_mm=axis.origin_mm, direction=axis.direction)
            for name, axis in ((a, machine.axes[a]) for a in machine.axis_names)
        },
        limits=LimitsInfo(max_correction_um=limits.max_correction_um, max_rate_um_per_min=limits.max_rate_um_per_min),
        remaining_um=served.remaining_um,
        served=_tables(served.errors),
        target=_tables(target.errors) if moving else None,
    )
    said = reply.model_dump_json(exclude={"time", "warnings", "version"})
    return reply.model_copy(update={"version": hashlib.sha256(said.encode()).hexdigest()[:16]})


def _valid_until(state: MachineState) -> str | None:
    """Return when the telemetry in the map is stale; None where there is none in it."""
    newest = None if state.thermal is None else state.thermal.state
    if newest is None:
        return None
    return format_time(min(newest.time_s + state.settings.stale_after_s, LATEST_S))


def _body(state: MachineState, index: int, body: Body) -> BodyInfo:
    terms: dict[str, list[str]] = {"motion": [], "location": []}
    for term in state.machine.terms:
        if term.body == index:
            terms[term.kind].append(term.name)
    return BodyInfo(
        name=body.name,
        lower=None if body.lower < 0 else state.machine.bodies[body.lower].name,
        axis=body.axis,
        motion_terms=terms["motion"],
        location_terms=terms["location"],
    )


def _tables(errors: ErrorMap) -> ErrorTables:
    tables: dict[str, dict[str, Any]] = {
        f"{kind}_{unit}": {} for kind in ("motion", "location") for unit in ("um", "urad")
    }
    location = iter(errors.location.tolist())
    for term in errors.machine.terms:
        table = tables[f"{term.kind}_{term.unit}"]
        if term.kind == "location":
            table[term.name] = next(location) / term.to_internal
        else:
            table[term.name] = (errors.motion[term.axis][DIRECTIONS.index(term.direction)] / term.to_internal).tolist()
    return ErrorTables(knots_mm={axis: knots.tolist() for axis, knots in errors.knots.items()}, **tables)
