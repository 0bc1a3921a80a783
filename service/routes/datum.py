"""`/v1/machines/{name}/datum`: the thermal state that displacements are measured against."""

from __future__ import annotations

import logging
from collections.abc import Callable
from http import HTTPStatus

from fastapi import APIRouter, Request

from service.access.roles import Role, caller_of, needs
from service.machine_state import MachineState
from service.problems import Problem
from service.routes.dependencies import NamedMachine, header
from service.schemas import Datum, DatumReply
from service.store import audit
from service.store.journal import DURABLE_S
from service.store.store import Store
from service.store.unavailable import StorageUnavailable
from service.thermal import Thermal, Zero
from service.timestamps import format_time

log = logging.getLogger(__name__)
router = APIRouter(prefix="/v1", tags=["datum"])


@router.post("/machines/{name}/datum", dependencies=[needs(Role.GATEWAY)])
async def set_datum(machine: NamedMachine, http: Request) -> DatumReply:
    """Make the present thermal state the zero: for instance where the workpiece was touched off.

    The correction moves there no faster than its rate limit. A datum survives a restart; where the database takes
    no writes, the answer is 503 and the datum stays as it was.
    """
    if _thermal(machine).state is None:
        detail = f"machine '{machine.machine.name}' must have telemetry before it has a datum; post some first"
        raise Problem(HTTPStatus.CONFLICT, "no-thermal-state", detail)
    return await _change(machine, http, "datum set", Thermal.set_datum)


@router.delete("/machines/{name}/datum", dependencies=[needs(Role.GATEWAY)])
async def clear_datum(machine: NamedMachine, http: Request) -> DatumReply:
    """Return to absolute displacements.

    A network that was trained on changes alone has none; it returns to the first telemetry sample.
    """
    return await _change(machine, http, "datum cleared", Thermal.clear_datum)


def datum_of(machine: MachineState) -> Datum:
    """Return the datum in force."""
    zero = machine.zero
    return Datum(kind=zero.kind, time=None if zero.time_s is None else format_time(zero.time_s))


def _thermal(machine: MachineState) -> Thermal:
    if machine.thermal is None:
        detail = f"machine '{machine.machine.name}' has no network, so it has no thermal state to take as a datum"
        raise Problem(HTTPStatus.CONFLICT, "no-thermal-state", detail)
    return machine.thermal


async def _change(machine: MachineState, http: Request, action: str, change: Callable[[Thermal], object]) -> DatumReply:
    """Change the datum and make that durable; where it cannot be, leave the datum as it was."""
    thermal, store = _thermal(machine), _store(http)
    if store.journal.failure is not None:
        raise _unchanged(store.journal.failure)
    before = thermal.memory()
    change(thermal)
    zero = thermal.zero
    _record(machine, http, action, zero)
    reply = _reply(machine)
    try:
        await store.journal.durable(DURABLE_S)
    except StorageUnavailable as problem:
        if machine.thermal is thermal and thermal.zero is zero:
            thermal.put_zeros(before.run_start, before.zero)
            _record(machine, http, f"{action}, and undone since it was not stored", before.zero)
        raise _unchanged(problem.reason) from None
    log.info("datum changed", extra={"machine": machine.machine.name, "datum": zero.kind})
    return reply


def _record(machine: MachineState, http: Request, action: str, zero: Zero) -> None:
    if machine.recorder is not None:
        machine.recorder.snapshot(machine)
    detail = {"kind": zero.kind, "time": None if zero.time_s is None else format_time(zero.time_s)}
    _store(http).journal.write(audit.record(caller_of(http).name, action, machine.machine.name, detail))


def _unchanged(reason: str) -> StorageUnavailable:
    return StorageUnavailable(reason, "the datum stays as it was; set it again later")


def _store(http: Request) -> Store:
    store: Store = http.app.state.store
    return store


def _reply(machine: MachineState) -> DatumReply:
    outlook = machine.outlook(machine.now())
    return DatumReply(**header(machine, outlook.now_s, outlook.status), datum=datum_of(machine))
