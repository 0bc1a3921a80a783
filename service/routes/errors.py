"""`/v1/machines/{name}/errors`: all error terms now."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from fastapi import APIRouter, Query

from model.terms import UM
from model.transforms import Array
from service.machine_state import MachineState
from service.outcome import Outlook
from service.problems import unprocessable
from service.routes.dependencies import NamedMachine, check_time, coordinates, header
from service.schemas import MAX_POSITIONS_PER_REQUEST, ErrorsQuery, ErrorsReply, TermErrors

router = APIRouter(prefix="/v1", tags=["errors"])


@router.get("/machines/{name}/errors")
async def show_errors(machine: NamedMachine, query: Annotated[ErrorsQuery, Query()]) -> ErrorsReply:
    """Show every error term, geometric, thermal and total: the target that corrections move towards.

    At positions (`?X=10&Y=20&Z=30`, each axis once for every position), which may leave the axes' ranges by what a
    correction may be; or, without positions, at the knots of the error map, between which it is linear.
    """
    if query.time is not None:
        check_time(machine, query.time, "key 'time' in the query")
    outlook = machine.outlook(machine.now(query.time))
    q = _positions(machine, query)
    terms = _on_grid(machine, outlook) if q is None else _at(machine, outlook, q)
    return ErrorsReply(
        **header(machine, outlook.now_s, outlook.status),
        warnings=outlook.warnings,
        reliability=outlook.target.weight,
        terms=terms,
    )


def _positions(machine: MachineState, query: ErrorsQuery) -> Array | None:
    given: dict[str, list[float]] = query.model_dump(exclude={"time"}, exclude_none=True)
    if not given:
        return None
    counts = {axis: len(values) for axis, values in given.items()}
    if len(set(counts.values())) > 1:
        got = ", ".join(f"{axis} {count} times" for axis, count in counts.items())
        raise unprocessable(f"each axis must be given once for every position, got {got}")
    count = next(iter(counts.values()))
    if count > MAX_POSITIONS_PER_REQUEST:
        raise unprocessable(f"at most {MAX_POSITIONS_PER_REQUEST} positions go into one request, got {count}")
    positions = [{axis: values[i] for axis, values in given.items()} for i in range(count)]
    return coordinates(machine, positions, beyond_mm=machine.machine.limits.max_correction_um * UM)


def _at(machine: MachineState, outlook: Outlook, q: Array) -> list[TermErrors]:
    geometric, thermal = machine.evaluate(outlook, q)
    axes = machine.machine.axis_names
    return [
        _term(machine, k, q[:, axes.index(t.axis)] if t.kind == "motion" else None, geometric, thermal)
        for k, t in enumerate(machine.machine.terms)
    ]


def _on_grid(machine: MachineState, outlook: Outlook) -> list[TermErrors]:
    knots = outlook.target.errors.knots
    axes = machine.machine.axis_names
    longest = max(len(k) for k in knots.values())
    # All axes walk along their knots together; each stays at its end once it is there.
    q = np.stack([np.pad(knots[a], (0, longest - len(knots[a])), mode="edge") for a in axes], axis=1)
    geometric, thermal = machine.evaluate(outlook, q)
    terms = []
    for k, term in enumerate(machine.machine.terms):
        at = knots[term.axis] if term.kind == "motion" else None
        count = 1 if at is None else len(at)
        terms.append(_term(machine, k, at, geometric[:count], thermal[:count]))
    return terms


def _term(machine: MachineState, k: int, at_mm: Array | None, geometric: Array, thermal: Array) -> TermErrors:
    term = machine.machine.terms[k]
    return TermErrors(
        term=term.name,
        unit=term.unit,
        axis=term.axis if term.kind == "motion" else None,
        at_mm=None if at_mm is None else at_mm.tolist(),
        geometric=(geometric[:, k] / term.to_internal).tolist(),
        thermal=(thermal[:, k] / term.to_internal).tolist(),
        total=((geometric[:, k] + thermal[:, k]) / term.to_internal).tolist(),
    )
