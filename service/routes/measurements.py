"""`/v1/machines/{name}/measurements`: probed deviations, compared with what was predicted."""

from __future__ import annotations

import asyncio
import math
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Query, Request

from service.access.roles import Role, needs
from service.machine_state import MachineState
from service.measurements import rows
from service.measurements.compare import Outcome, Probed, compare
from service.measurements.drift import Component
from service.measurements.history import KEPT_S
from service.measurements.schemas import (
    DriftReply,
    Measurement,
    MeasurementReply,
    MeasurementsQuery,
    MeasurementsReply,
    MeasurementsRequest,
    PartialVector,
)
from service.problems import Problem, unprocessable
from service.routes.dependencies import NamedMachine, check_time, coordinates, header
from service.store.journal import Insert
from service.store.store import Store
from service.store.tables import measurements
from service.timestamps import format_time

DURABLE_WITHIN_S = 5.0
"""How long a reply waits for the disk [s]; then it is a 503, and the measurements may be stored yet."""

router = APIRouter(prefix="/v1", tags=["measurements"])


@router.post("/machines/{name}/measurements", dependencies=[needs(Role.GATEWAY)])
async def take_measurements(
    machine: NamedMachine, measured: MeasurementsRequest, request: Request
) -> MeasurementsReply:
    """Take probed deviations; all or, where one is wrong, none. The reply comes once they are stored.

    Each is compared with the prediction of its moment, which is known for the last two hours of telemetry. With
    `compensated` the probe found what an active correction had left.
    """
    if machine.thermal is None or machine.thermal.state is None:
        what = "has no network" if machine.thermal is None else "has had no telemetry"
        detail = f"machine '{machine.machine.name}' must have a prediction to compare with, and {what}"
        raise Problem(HTTPStatus.CONFLICT, "no-thermal-state", detail)
    every = measured.measurements
    positions = coordinates(machine, (m.position for m in every), where="measurements[{}].position")
    probed = [_probed(m, tuple(p)) for m, p in zip(every, positions.tolist(), strict=True)]
    found = [_outcome(machine, p, index) for index, p in enumerate(probed)]
    store: Store = request.app.state.store
    model, axes, now_s = machine.bundle.version, machine.machine.axis_names, machine.now()
    new = [rows.row(machine.machine.name, axes, model, now_s, p, o) for p, o in zip(probed, found, strict=True)]
    store.journal.write(Insert(measurements, new))
    machine.monitor.add(model, [o.compared for o in found if o.compared is not None])
    await store.journal.durable(DURABLE_WITHIN_S)
    return _reply(machine, [_shown(rows.stored(r)) for r in new])


@router.get("/machines/{name}/measurements")
async def list_measurements(
    machine: NamedMachine, query: Annotated[MeasurementsQuery, Query()], request: Request
) -> MeasurementsReply:
    """List the newest measurements, and what all of the present model say: running residual, trend and drift."""
    store: Store = request.app.state.store
    name, since_s = machine.machine.name, query.since or 0.0
    found = await asyncio.to_thread(rows.read, store.engine, name, query.limit, since_s)
    return _reply(machine, [_shown(one) for one in found])


def _probed(measurement: Measurement, position: tuple[float, ...]) -> Probed:
    d = measurement.deviation_um
    x, y, z = (math.nan if v is None else v for v in (d.x, d.y, d.z))
    tool_length_mm = None if measurement.tool is None else measurement.tool.length_mm
    return Probed(
        measurement.time, position, (x, y, z), measurement.uncertainty_um, measurement.compensated, tool_length_mm
    )


def _outcome(machine: MachineState, probed: Probed, index: int) -> Outcome:
    where = f"key 'time' in measurements[{index}]"
    check_time(machine, probed.time_s, where)
    newest = machine.past()
    latest_s = newest.time_s + machine.settings.stale_after_s
    past = machine.history.at(probed.time_s, newest) if probed.time_s <= latest_s else None
    if past is None:
        first_s = machine.history.from_s if machine.history.from_s is not None else newest.time_s
        raise unprocessable(
            f"{where} must lie within what is known of the last {KEPT_S / 3600:g} h of telemetry, "
            f"{format_time(first_s)} to {format_time(latest_s)}, got {format_time(probed.time_s)}; "
            "post measurements soon after they are taken, and telemetry before them"
        )
    return compare(machine, probed, past)


def _reply(machine: MachineState, shown: list[MeasurementReply]) -> MeasurementsReply:
    outlook = machine.outlook(machine.now())
    return MeasurementsReply(
        **header(machine, outlook.now_s, outlook.status),
        warnings=outlook.warnings,
        drift=drift_of(machine),
        measurements=shown,
    )


def drift_of(machine: MachineState) -> DriftReply:
    """Return what the monitor says of the present model."""
    drift = machine.monitor.drift(machine.bundle.version)
    x, y, z = drift.components

    def each(value: str) -> PartialVector:
        return PartialVector(x=getattr(x, value), y=getattr(y, value), z=getattr(z, value))

    components: tuple[Component, ...] = drift.components
    return DriftReply(
        drifting=drift.drifting,
        running_residual_um=each("running_um"),
        limit_um=each("limit_um"),
        trend_um_per_day=each("trend_um_per_day"),
        trend_standard_error_um_per_day=each("trend_sd_um_per_day"),
        sessions=max(c.sessions for c in components),
    )


def _shown(stored: rows.Stored) -> MeasurementReply:
    body = stored.body
    measured, predicted = body["deviation_um"], body["predicted_um"]
    residual = None
    if predicted is not None:
        residual = {k: None if measured[k] is None else measured[k] - predicted[k] for k in "xyz"}
    return MeasurementReply(
        time=format_time(stored.time_s),
        model=stored.model,
        position=body["position"],
        deviation_um=PartialVector(**measured),
        compensated=body["compensated"],
        predicted_um=None if predicted is None else PartialVector(**predicted),
        residual_um=None if residual is None else PartialVector(**residual),
        interval_um=body["half_width_um"],
        note=body["why"],
    )
