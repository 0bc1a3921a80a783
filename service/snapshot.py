"""All that a machine's service remembers, as JSON and back. Pure functions.

Python writes floats so that they come back bit for bit, so a restored state is the same state.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from model.error_map import ErrorMap
from model.machine import Machine
from model.predictor import ThermalState
from model.transforms import Array
from service.guard import Track
from service.safety import Served, is_usable
from service.thermal import Memory, Zero

FORMAT = 1
MALFORMED = (ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError)
"""What comes of reading a text that is not what it should be."""


class SnapshotError(ValueError):
    """A snapshot that does not fit: the end of a sentence that starts with "the snapshot"."""


@dataclass(frozen=True)
class Snapshot:
    """What a machine's service remembers at a moment.

    Attributes
    ----------
    model : version of the bundle
    memory : of the thermal part, None where the bundle has no network
    served : what was served last, with its time on the steady clock; None before anything was
    tool_lengths_mm : the shortest and longest tool seen, None before the first
    boot : the start of the computer that the steady clock belongs to, None where it is not known
    refused : why its memory has the datum alone, where it is from a text of which no more could be used
    last : whether it was taken at the end, so that nothing was served after it
    """

    model: str
    memory: Memory | None
    served: Served | None
    tool_lengths_mm: tuple[float, float] | None
    boot: str | None
    refused: str | None = None
    last: bool = False

    @property
    def time_s(self) -> float | None:
        """When its newest sample was; None before the first."""
        return None if self.memory is None or self.memory.state is None else self.memory.state.time_s


def to_json(snapshot: Snapshot) -> str:
    """Return a snapshot as text."""
    served = snapshot.served
    content = {
        "format": FORMAT,
        "model": snapshot.model,
        "memory": None if snapshot.memory is None else _memory_out(snapshot.memory),
        "served": None if served is None else {**vars(served), "errors": _map_out(served.errors)},
        "tool_lengths_mm": snapshot.tool_lengths_mm,
        "boot": snapshot.boot,
        "last": snapshot.last,
    }
    return json.dumps(content, separators=(",", ":"))


def from_json(text: str, machine: Machine) -> Snapshot:
    """Return the snapshot in a text, of any bundle of the machine.

    A thermal state that this release does not take, as after an update, leaves what was served and the datum.

    Raises
    ------
    SnapshotError
        where it is damaged, of another format, or of a machine with other axes or terms.
    """
    try:
        content = json.loads(text)
        if content["format"] != FORMAT:
            raise SnapshotError(f"must have format {FORMAT}, got {content['format']!r:.20}")
        memory, served, tools = content["memory"], content["served"], content["tool_lengths_mm"]
        zeros = None if memory is None else _zeros_in(memory, machine)
        snapshot = Snapshot(
            str(content["model"]),
            None if zeros is None else Memory(None, {}, {}, {}, None, np.zeros(0), {}, *zeros),
            None if served is None else _served_in(served, machine),
            None if tools is None else (_number(tools[0]), _number(tools[1])),
            None if content["boot"] is None else str(content["boot"]),
            last=content.get("last") is True,
        )
    except MALFORMED as problem:
        raise _damaged(problem) from None
    if zeros is None:
        return snapshot
    try:
        return replace(snapshot, memory=_memory_in(memory, zeros))
    except MALFORMED as problem:
        return replace(snapshot, refused=str(_damaged(problem)))


def _damaged(problem: Exception) -> SnapshotError:
    if isinstance(problem, SnapshotError):
        return problem
    return SnapshotError(f"is damaged: {type(problem).__name__}: {' '.join(str(problem).split())[:80]}")


def _memory_out(memory: Memory) -> dict[str, Any]:
    same = memory.zero is memory.run_start
    return {
        "state": None if memory.state is None else {k: _plain(v) for k, v in vars(memory.state).items()},
        "tracks": {name: asdict(track) for name, track in memory.tracks.items()},
        "faults": dict(memory.faults),
        "held": dict(memory.held),
        "failure": memory.failure,
        "channels": memory.channels.tolist(),
        "heard_s": dict(memory.heard_s),
        "run_start": _zero_out(memory.run_start),
        "zero": None if same else _zero_out(memory.zero),
    }


def _zeros_in(content: Mapping[str, Any], machine: Machine) -> tuple[Zero, Zero]:
    run_start = _zero_in(content["run_start"], machine)
    return run_start, run_start if content["zero"] is None else _zero_in(content["zero"], machine)


def _memory_in(content: Mapping[str, Any], zeros: tuple[Zero, Zero]) -> Memory:
    state = content["state"]
    return Memory(
        None if state is None else _state_in(state),
        {name: Track(**{k: _frozen(v) for k, v in track.items()}) for name, track in content["tracks"].items()},
        {str(k): str(v) for k, v in content["faults"].items()},
        {str(k): str(v) for k, v in content["held"].items()},
        None if content["failure"] is None else str(content["failure"]),
        _array(content["channels"]),
        {str(k): _number(v) for k, v in content["heard_s"].items()},
        *zeros,
    )


def _state_in(content: Mapping[str, Any]) -> ThermalState:
    wanted = {f.name for f in fields(ThermalState)}
    if set(content) != wanted:
        raise SnapshotError(f"must have a state of {', '.join(sorted(wanted))}, got {', '.join(sorted(content))}")
    values: dict[str, Any] = {k: _array(v) if isinstance(v, list) else _number(v) for k, v in content.items()}
    return ThermalState(**values)


def _zero_out(zero: Zero) -> dict[str, Any]:
    return {
        "kind": zero.kind,
        "errors": None if zero.errors is None else _map_out(zero.errors),
        "time_s": zero.time_s,
        "modes": None if zero.modes is None else zero.modes.tolist(),
    }


def _zero_in(content: Mapping[str, Any], machine: Machine) -> Zero:
    kind, errors, time_s, modes = content["kind"], content["errors"], content["time_s"], content["modes"]
    if kind not in ("absolute", "run-start", "set"):
        raise SnapshotError(f"must have a datum of a known kind, got {kind!r:.20}")
    return Zero(
        kind,
        None if errors is None else _map_in(errors, machine),
        None if time_s is None else _number(time_s),
        None if modes is None else _array(modes),
    )


def _served_in(content: Mapping[str, Any], machine: Machine) -> Served:
    held = content["held"]
    if not isinstance(held, bool):
        raise SnapshotError("must say whether the correction was held")
    numbers = _number(content["time_s"]), _number(content["remaining_um"])
    return Served(_map_in(content["errors"], machine), *numbers, held)


def _map_out(errors: ErrorMap) -> dict[str, Any]:
    return {
        "terms": [t.name for t in errors.machine.terms],
        "knots": {a: errors.knots[a].tolist() for a in errors.machine.axis_names},
        "motion": {a: errors.motion[a].tolist() for a in errors.machine.axis_names},
        "location": errors.location.tolist(),
    }


def _map_in(content: Mapping[str, Any], machine: Machine) -> ErrorMap:
    if content["terms"] != [t.name for t in machine.terms] or set(content["knots"]) != set(machine.axis_names):
        raise SnapshotError("must be of a machine with the same axes and error terms")
    knots = {a: _array(content["knots"][a]) for a in machine.axis_names}
    motion = {a: _array(content["motion"][a]) for a in machine.axis_names}
    errors = ErrorMap(machine, knots, motion, _array(content["location"]))
    fits = errors.location.shape == (len(machine.location_columns),) and all(
        len(knots[a]) > 0 and motion[a].shape == (6, len(knots[a])) and (np.diff(knots[a]) > 0).all() for a in knots
    )
    if not fits or not is_usable(errors):
        raise SnapshotError("must have error maps with usable numbers at rising positions")
    return errors


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


def _frozen(value: Any) -> Any:
    return tuple(_frozen(v) for v in value) if isinstance(value, list) else value


def _array(value: Any) -> Array:
    array = np.array(value, dtype=float)
    if not np.isfinite(array).all():
        raise SnapshotError("must have finite numbers")
    return array


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise SnapshotError(f"must have finite numbers, got {value!r:.20}")
    return float(value)
