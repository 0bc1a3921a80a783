"""`/v1/machines`: what is served."""

from __future__ import annotations

from fastapi import APIRouter, Request

from service.machine_state import MachineState
from service.routes.datum import datum_of
from service.routes.dependencies import NamedMachine, header, loaded_machines
from service.schemas import AxisInfo, LimitsInfo, MachineReply, MachinesReply, SensorInfo, TermInfo
from service.timestamps import format_time

router = APIRouter(prefix="/v1", tags=["machines"])


@router.get("/machines")
async def list_machines(request: Request) -> MachinesReply:
    """List all machines."""
    return MachinesReply(machines=[describe(m) for m in loaded_machines(request).values()])


@router.get("/machines/{name}")
async def show_machine(machine: NamedMachine) -> MachineReply:
    """Show one machine: its axes, terms, sensors, model version and status."""
    return describe(machine)


def describe(state: MachineState) -> MachineReply:
    """Return what is served for a machine."""
    machine, thermal = state.machine, state.thermal
    outlook = state.outlook(state.now())
    limits = machine.limits
    newest = None if thermal is None else thermal.state
    taken: dict[str, float] = {}
    if thermal is not None and newest is not None:
        taken = dict(zip(thermal.sensors, newest.inputs.tolist(), strict=False))
    return MachineReply(
        **header(state, outlook.now_s, outlook.status),
        warnings=outlook.warnings,
        axes={a: AxisInfo(range_mm=(machine.axes[a].low, machine.axes[a].high)) for a in machine.axis_names},
        tool_offset_mm=machine.tool.offset_mm,
        sensors={
            name: SensorInfo(
                range_degC=sensor.range_degC,
                max_rate_degC_per_min=sensor.max_rate_degC_per_min,
                used=thermal is not None and name in thermal.sensors,
                valid_range_degC=None if thermal is None else thermal.record.valid_range_degC.get(name),
                taken_degC=taken.get(name),
                fault=None if thermal is None else thermal.faults.get(name),
            )
            for name, sensor in machine.sensors.items()
        },
        channels=[] if thermal is None else list(thermal.predictor.channels),
        terms=[
            TermInfo(term=t.name, unit=t.unit, kind=t.kind, axis=t.axis if t.kind == "motion" else None)
            for t in machine.terms
        ],
        limits=LimitsInfo(max_correction_um=limits.max_correction_um, max_rate_um_per_min=limits.max_rate_um_per_min),
        datum=datum_of(state),
        telemetry_time=None if newest is None else format_time(newest.time_s),
        correction_um=state.largest_correction_um(),
        remaining_um=None if state.served is None else state.served.remaining_um,
        reliability=outlook.target.weight,
    )
