"""`/v1/machines/{name}/datum`: the thermal state that displacements are measured against."""

from __future__ import annotations

import logging
from http import HTTPStatus

from fastapi import APIRouter

from service.machine_state import MachineState
from service.problems import Problem
from service.routes.dependencies import NamedMachine, header
from service.schemas import Datum, DatumReply
from service.thermal import Thermal
from service.timestamps import format_time

log = logging.getLogger(__name__)
router = APIRouter(prefix="/v1", tags=["datum"])


@router.post("/machines/{name}/datum")
async def set_datum(machine: NamedMachine) -> DatumReply:
    """Make the present thermal state the zero: for instance where the workpiece was touched off.

    The correction moves there no faster than its rate limit.
    """
    if not _thermal(machine).set_datum():
        detail = f"machine '{machine.machine.name}' must have telemetry before it has a datum; post some first"
        raise Problem(HTTPStatus.CONFLICT, "no-thermal-state", detail)
    return _reply(machine)


@router.delete("/machines/{name}/datum")
async def clear_datum(machine: NamedMachine) -> DatumReply:
    """Return to absolute displacements.

    A network that was trained on changes alone has none; it returns to the first telemetry sample.
    """
    _thermal(machine).clear_datum()
    return _reply(machine)


def datum_of(machine: MachineState) -> Datum:
    """Return the datum in force."""
    zero = machine.zero
    return Datum(kind=zero.kind, time=None if zero.time_s is None else format_time(zero.time_s))


def _thermal(machine: MachineState) -> Thermal:
    if machine.thermal is None:
        detail = f"machine '{machine.machine.name}' has no network, so it has no thermal state to take as a datum"
        raise Problem(HTTPStatus.CONFLICT, "no-thermal-state", detail)
    return machine.thermal


def _reply(machine: MachineState) -> DatumReply:
    datum = datum_of(machine)
    log.info("datum changed", extra={"machine": machine.machine.name, "datum": datum.kind})
    outlook = machine.outlook(machine.now())
    return DatumReply(**header(machine, outlook.now_s, outlook.status), datum=datum)
