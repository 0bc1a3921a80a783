"""What routes share: the machine that a path names, checked names, times and positions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from http import HTTPStatus
from typing import Annotated, Any

import numpy as np
from fastapi import Depends, Request
from starlette.requests import HTTPConnection

from model.transforms import Array
from model.validation import did_you_mean
from service.machine_state import MachineState
from service.problems import Problem, unprocessable
from service.schemas import Sample
from service.status import Status
from service.thermal import MAX_AHEAD_S
from service.timestamps import format_time

MAX_REPLAY_S = 86400.0
"""`MAX_AHEAD_S` in replay, which runs ahead; it still refuses milliseconds and wrong years."""


def loaded_machines(request: HTTPConnection) -> dict[str, MachineState]:
    """Return all machines by name.

    Raises
    ------
    Problem
        503 until they are loaded.
    """
    machines: dict[str, MachineState] | None = getattr(request.app.state, "machines", None)
    if machines is None:
        detail = "the bundles must be loaded before requests are answered, and are not yet; try again in a second"
        raise Problem(HTTPStatus.SERVICE_UNAVAILABLE, "not-ready", detail, {"Retry-After": "1"})
    return machines


async def named_machine(name: str, request: Request) -> MachineState:
    """Return the machine that the path names."""
    return machine_named(name, request)


def machine_named(name: str, request: HTTPConnection) -> MachineState:
    """Return the machine of that name.

    Raises
    ------
    Problem
        404 where there is none, 503 until they are loaded.
    """
    machines = loaded_machines(request)
    if name not in machines:
        hint = did_you_mean(name[:64], list(machines))
        raise Problem(HTTPStatus.NOT_FOUND, "unknown-machine", f"unknown machine '{name}'{hint}")
    return machines[name]


NamedMachine = Annotated[MachineState, Depends(named_machine)]


def header(machine: MachineState, now_s: float, status: Status) -> dict[str, Any]:
    """Return the keys that every reply about a machine starts with (`schemas.Header`)."""
    name, version = machine.machine.name, machine.bundle.version
    return {"machine": name, "time": format_time(now_s), "model": version, "status": status}


def check_time(machine: MachineState, time_s: float, where: str) -> None:
    """Refuse a time too far ahead of the service's clock."""
    now_s = machine.clock()
    most_s = MAX_REPLAY_S if machine.settings.replay else MAX_AHEAD_S
    if time_s > now_s + most_s:
        raise unprocessable(
            f"{where} must not be more than {most_s:g} s ahead of the service's clock, {format_time(now_s)}; "
            f"got {format_time(time_s)}; set the sender's clock, and give seconds in UTC"
        )


def check_samples(machine: MachineState, samples: Iterable[Sample], where: str) -> None:
    """Refuse samples with a sensor or channel that the machine does not have; `where` ends in {} for the index."""
    channels = machine.thermal.predictor.channels if machine.thermal is not None else None
    for index, sample in enumerate(samples):
        at = where.format(index)
        check_time(machine, sample.time, f"key 'time'{at}")
        _check_names("sensor", sample.temperatures, machine.machine.sensors, machine, at)
        if channels is not None:
            _check_names("channel", sample.channels, channels, machine, at)


def _check_names(what: str, given: Iterable[str], known: Iterable[str], machine: MachineState, at: str) -> None:
    for name in given:
        if name not in known:
            hint = did_you_mean(name, list(known)) or f"; it has no {what}s"
            raise unprocessable(f"unknown {what} '{name}'{at} for machine '{machine.machine.name}'{hint}")


def coordinates(
    machine: MachineState,
    positions: Iterable[Mapping[str, float]],
    beyond_mm: float = 0.0,
    where: str = "positions[{}]",
) -> Array:
    """Return positions as an array of shape (n, A), every axis given and within its range.

    Parameters
    ----------
    beyond_mm : how far outside the range a coordinate may be, such as a corrected one
    where : what stands for a position in messages, with {} for its index
    """
    axes = [machine.machine.axes[name] for name in machine.machine.axis_names]
    ranges = {axis.name: (axis.low - beyond_mm, axis.high + beyond_mm) for axis in axes}
    rows = []
    for index, position in enumerate(positions):
        if position.keys() == ranges.keys() and all(low <= position[n] <= high for n, (low, high) in ranges.items()):
            rows.append([position[name] for name in ranges])
            continue
        at = f"in {where.format(index)}"
        _check_names("axis", position, machine.machine.axes, machine, f" {at}")
        for axis in axes:
            value = position.get(axis.name)
            if value is None:
                got = ", ".join(position) or "none"
                raise unprocessable(f"axis '{axis.name}' must be given {at}, got {got}; give all axes [mm]")
            if not axis.low - beyond_mm <= value <= axis.high + beyond_mm:
                raise unprocessable(
                    f"axis '{axis.name}' must lie within {axis.low:g} and {axis.high:g} mm, got {value:.10g} {at}"
                )
        rows.append([position[axis.name] for axis in axes])
    return np.array(rows, dtype=float)
