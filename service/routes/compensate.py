"""`/v1/machines/{name}/compensate`: programmed positions in, corrected coordinates out."""

from __future__ import annotations

from itertools import repeat
from typing import Annotated

from fastapi import APIRouter, Query

from model.terms import UM
from model.transforms import Array
from service.explain import explain
from service.machine_state import Correction, MachineState
from service.problems import unprocessable
from service.routes.dependencies import NamedMachine, check_samples, check_time, coordinates, header
from service.schemas import (
    MAX_EXPLAINED_PER_REQUEST,
    CompensateQuery,
    CompensateReply,
    CompensateRequest,
    Explanation,
    Point,
    Sample,
    Vector,
)

router = APIRouter(prefix="/v1", tags=["compensation"])


@router.post("/machines/{name}/compensate", response_model_exclude_none=True)
async def correct_positions(
    machine: NamedMachine, request: CompensateRequest, query: Annotated[CompensateQuery, Query()]
) -> CompensateReply:
    """Return the coordinates to command so that the tool tip ends up at the programmed positions.

    Temperatures, where given, count as a telemetry sample first. Where any part of the request is wrong, nothing
    is computed and no sample taken.

    With `?explain=true` each point says what each error term has to do with its `deviation_um`: its share in the
    workpiece frame, geometric and thermal apart.
    """
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
) -> CompensateReply:
    outlook = correction.outlook
    axes = machine.machine.axis_names
    rows = zip(
        correction.corrected.tolist(),
        correction.correction_mm.tolist(),
        (correction.deviation_mm / UM).tolist(),
        correction.limited.tolist(),
        explanations or repeat(None, len(correction.limited)),
        strict=True,
    )
    return CompensateReply(
        **header(machine, outlook.now_s, outlook.status),
        warnings=warnings + outlook.warnings,
        points=[
            Point(
                corrected=dict(zip(axes, corrected, strict=True)),
                correction=dict(zip(axes, change, strict=True)),
                deviation_um=Vector(x=deviation[0], y=deviation[1], z=deviation[2]),
                limited=limited,
                explanation=explanation,
            )
            for corrected, change, deviation, limited, explanation in rows
        ],
    )
