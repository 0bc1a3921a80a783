"""Measurements as rows of the database, and back."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sqlalchemy import Engine, select

from service.measurements.compare import Outcome, Probed
from service.measurements.drift import Compared
from service.measurements.monitor import MOST
from service.store.tables import measurements

if TYPE_CHECKING:
    from service.machine_state import MachineState


@dataclass(frozen=True)
class Stored:
    """A row.

    Attributes
    ----------
    model : version of the bundle that it was compared with
    body : of JSON; see `row`
    """

    time_s: float
    model: str
    body: dict[str, Any]


def row(
    machine: str, axes: Sequence[str], model: str, received_s: float, probed: Probed, outcome: Outcome
) -> dict[str, Any]:
    """Return the row of a measurement; what is not known is null in its body."""
    compared = outcome.compared
    body = {
        "position": dict(zip(axes, probed.position, strict=True)),
        "deviation_um": _vector(probed.deviation_um),
        "uncertainty_um": probed.uncertainty_um,
        "compensated": probed.compensated,
        "tool_length_mm": probed.tool_length_mm,
        "predicted_um": None if outcome.predicted_um is None else _vector(outcome.predicted_um),
        "half_width_um": outcome.half_width_um,
        "sd_um": None if compared is None else compared.sd_um,
        "datum_sd_um": None if compared is None else compared.datum_sd_um,
        "datum_s": None if compared is None else compared.datum_s,
        "why": outcome.why,
    }
    return {
        "machine": machine,
        "time_s": probed.time_s,
        "received_s": received_s,
        "model": model,
        "body": json.dumps(body, allow_nan=False),
    }


def read(engine: Engine, machine: str, limit: int, since_s: float = 0.0) -> list[Stored]:
    """Return the newest measurements of a machine from a time on, newest first."""
    wanted = (
        select(measurements.c.time_s, measurements.c.model, measurements.c.body)
        .where(measurements.c.machine == machine, measurements.c.time_s >= since_s)
        .order_by(measurements.c.time_s.desc(), measurements.c.id.desc())
        .limit(limit)
    )
    with engine.connect() as connection:
        return [Stored(time_s, model, json.loads(body)) for time_s, model, body in connection.execute(wanted)]


def compared_of(stored: Stored, axes: Sequence[str]) -> Compared | None:
    """Return what the drift monitor makes of a row; None where it was not compared, or of other axes."""
    body = stored.body
    if body["sd_um"] is None or set(body["position"]) != set(axes):
        return None
    measured, predicted = body["deviation_um"], body["predicted_um"]
    x, y, z = (math.nan if measured[k] is None else measured[k] - predicted[k] for k in "xyz")
    place = tuple(body["position"][a] for a in axes)
    return Compared(stored.time_s, place, (x, y, z), body["sd_um"], body["datum_sd_um"], body["datum_s"])


def load_into(machine: MachineState, engine: Engine) -> None:
    """Let a machine's drift monitor go on from the stored measurements. It waits for the database."""
    axes = machine.machine.axis_names
    for one in reversed(read(engine, machine.machine.name, MOST)):
        compared = compared_of(one, axes)
        if compared is not None:
            machine.monitor.add(one.model, [compared])


def _vector(values: Sequence[float]) -> dict[str, float | None]:
    return {k: None if math.isnan(v) else v for k, v in zip("xyz", values, strict=True)}


def stored(values: Mapping[str, Any]) -> Stored:
    """Return a row that is on its way into the database as it will come back."""
    return Stored(values["time_s"], values["model"], json.loads(values["body"]))
