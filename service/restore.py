"""Bring a machine back to where it was: from its snapshot and the telemetry after it, or from telemetry alone."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from sqlalchemy import Engine, func, or_, select

from model.bundle import Bundle
from model.machine import Machine
from model.shared_predictors import predictor_of
from service.guard import Track
from service.machine_state import MachineState
from service.schemas import Sample
from service.snapshot import Snapshot, SnapshotError, from_json
from service.store.tables import snapshots, telemetry
from service.thermal import Memory, Thermal, Zero
from service.timestamps import format_time

log = logging.getLogger(__name__)

MAX_REPLAYED = 50_000
"""How many stored samples a network is led through to settle; of more, every second, third ... is taken. They take
about five seconds, and at one a second are half a day."""
NEWEST = 1000
"""How many of the newest ones are all taken."""
SETTLED = 1.25
"""How many settling times to go back: with room for the gap before the first sample."""
MAX_BACK_S = 14 * 86400.0
"""How far to go back at most for the moment of a datum [s]."""


@dataclass(frozen=True)
class Rebuilt:
    """A thermal part that was led through stored telemetry.

    Attributes
    ----------
    thermal : settled as far as the telemetry reaches back
    warnings : what could not be rebuilt, and what was done instead
    """

    thermal: Thermal
    warnings: tuple[str, ...]


def restore(state: MachineState, engine: Engine) -> None:
    """Bring a machine that has just started back to where the last process left it. It waits for the database."""
    name = state.machine.name
    snapshot = _stored_snapshot(engine, state.machine)
    if snapshot is not None:
        state.resume(snapshot)
    if state.thermal is None:
        return
    memory = None if snapshot is None else snapshot.memory
    same_model = snapshot is not None and snapshot.model == state.bundle.version
    if same_model and memory is not None and memory.state is not None:
        if _fits(memory, state.thermal):
            state.thermal.recall(memory)
            newer = stored_samples(engine, name, after_s=memory.state.time_s, most=MAX_REPLAYED)
            count = _lead(state.thermal, newer)
            log.info("restored", extra={"machine": name, "replayed": count})
            return
        _not_used(name, "it must have the shape of its network's state")
    rebuilt = rebuild(state.bundle, memory, engine, state.thermal)
    if rebuilt.thermal.state is not None or rebuilt.warnings:
        for warning in rebuilt.warnings:
            log.warning("not rebuilt in full", extra={"machine": name, "reason": warning})
        log.info("rebuilt from telemetry", extra={"machine": name})
    state.thermal = rebuilt.thermal


def rebuild(bundle: Bundle, before: Memory | None, engine: Engine, fresh: Thermal | None = None) -> Rebuilt:
    """Lead a bundle's network through the telemetry that is stored for its machine. For a thread.

    Parameters
    ----------
    before : what another network of the same machine remembers: its datum is set anew where telemetry reaches back
    fresh : a thermal part of the bundle that has taken nothing yet; None makes one, which takes some milliseconds
    """
    record = bundle.manifest.network
    assert record is not None
    name = bundle.machine.name
    back_s = SETTLED * record.settling_time_s
    zeros = [] if before is None else [z for z in (before.run_start, before.zero) if z.time_s is not None]
    newest_s = newest_time(engine, name)
    if newest_s is None:
        samples: Iterable[Sample] = ()
    else:
        moments = [z.time_s for z in zeros if z.time_s is not None]
        from_s = max(min([newest_s, *moments]) - back_s, newest_s - max(MAX_BACK_S, back_s))
        samples = stored_samples(engine, name, after_s=from_s, most=MAX_REPLAYED, always=moments)
    return rebuilt(bundle, before, samples, fresh)


def rebuilt(bundle: Bundle, before: Memory | None, samples: Iterable[Sample], fresh: Thermal | None = None) -> Rebuilt:
    """Lead a bundle's network through samples, in the order of their times.

    Parameters
    ----------
    before : what another network remembers of the same time. Where the samples pass the moment of its datum, the
        datum is set there; otherwise its error map stays what is subtracted, and a warning says so
    fresh : as for `rebuild`

    Raises
    ------
    BundleError
        where the bundle's network cannot be loaded.
    """
    record = bundle.manifest.network
    assert record is not None
    thermal = Thermal(predictor_of(bundle), record, bundle.machine) if fresh is None else fresh
    wanted = [] if before is None else [before.zero] if before.zero.kind == "set" else []
    if before is not None and before.run_start.errors is not None and record.datum == "run-start":
        wanted.append(before.run_start)
    since_s = None if before is None or before.state is None else before.state.since_s
    found: dict[float, Zero] = {}
    for sample in samples:
        if before is not None and thermal.state is None and not thermal.tracks:
            thermal.tracks = _trusted(before, sample)
        thermal.take(sample)
        for zero in wanted:
            if thermal.state is not None and thermal.state.time_s == zero.time_s:
                seen_s = thermal.state.time_s - thermal.state.since_s
                if seen_s >= record.settling_time_s or thermal.state.since_s == since_s:
                    moment = thermal.moment(zero.kind)
                    assert moment is not None
                    found[zero.time_s] = moment
    own = thermal.memory().run_start
    put, warnings = {}, []
    for zero in wanted:
        assert zero.time_s is not None
        if zero.time_s not in found:
            warnings.append(
                f"telemetry must reach back to the datum of {format_time(zero.time_s)} to set it in this model, and "
                "does not; what the model before it predicted there stays subtracted; set the datum again"
            )
        put[zero.kind] = found.get(zero.time_s, replace(zero, modes=None))
    run_start = put.get("run-start", own)
    thermal.put_zeros(run_start, put.get("set", run_start))
    return Rebuilt(thermal, tuple(warnings))


def _trusted(before: Memory, first: Sample) -> dict[str, Track]:
    """Return the sensors that are believed now as believed at a first sample, too.

    It is the first one of what is led through, and not of the machine's: whatever of it surprises has been looked at.
    """
    readings = first.temperatures.items()
    known = {name for name in before.tracks if name not in before.faults}
    return {n: Track(r, first.time) for n, r in readings if n in known and r is not None and math.isfinite(r)}


def stored_samples(
    engine: Engine, machine: str, after_s: float, most: int | None = None, always: Iterable[float] = ()
) -> Iterator[Sample]:
    """Yield a machine's stored samples later than a time, in order.

    Parameters
    ----------
    most : about how many; of more, every second, third ... is left in, and all of the newest and those of `always`
    """
    stored = telemetry.c
    wanted = select(stored.time_s, stored.sample).where(stored.machine == machine, stored.time_s > after_s)
    with engine.connect() as connection:
        if most is not None:
            count = connection.execute(select(func.count()).select_from(wanted.subquery())).scalar() or 0
            if count > most:
                place = func.row_number().over(order_by=(stored.time_s, stored.id)).label("place")
                rows = wanted.add_columns(place, stored.id).subquery()
                stride = -(-count // most)
                keep = or_(rows.c.place % stride == 0, rows.c.place > count - NEWEST, rows.c.time_s.in_(tuple(always)))
                wanted = select(rows.c.time_s, rows.c.sample).where(keep).order_by(rows.c.place)
            else:
                wanted = wanted.order_by(stored.time_s, stored.id)
        else:
            wanted = wanted.order_by(stored.time_s, stored.id)
        for time_s, text in connection.execution_options(yield_per=1000).execute(wanted):
            content = json.loads(text)
            yield Sample.model_construct(
                time=time_s, temperatures=content["temperatures"], channels=content["channels"]
            )


def newest_time(engine: Engine, machine: str) -> float | None:
    """Return when a machine's newest stored sample was."""
    with engine.connect() as connection:
        found = connection.execute(select(func.max(telemetry.c.time_s)).where(telemetry.c.machine == machine)).scalar()
    return None if found is None else float(found)


def _stored_snapshot(engine: Engine, machine: Machine) -> Snapshot | None:
    with engine.connect() as connection:
        text = connection.execute(select(snapshots.c.state).where(snapshots.c.machine == machine.name)).scalar()
    if text is None:
        return None
    try:
        snapshot = from_json(text, machine)
    except SnapshotError as problem:
        _not_used(machine.name, f"it {problem}")
        return None
    if snapshot.refused is not None:
        _not_used(machine.name, f"its thermal state {snapshot.refused}")
    return snapshot


def _not_used(name: str, reason: str) -> None:
    log.warning("snapshot not used", extra={"machine": name, "reason": reason})


def _fits(memory: Memory, thermal: Thermal) -> bool:
    """Return whether a memory has the shape of a network's; its version says that it does."""
    predictor = thermal.predictor
    fresh = predictor.start(0.0, predictor.sensor_model.mean, np.zeros(len(predictor.channels)))
    return (
        all(np.shape(getattr(memory.state, f.name)) == np.shape(getattr(fresh, f.name)) for f in fields(fresh))
        and memory.channels.shape == (len(predictor.channels),)
        and set(memory.tracks) <= set(thermal.sensors)
    )


def _lead(thermal: Thermal, samples: Iterable[Sample]) -> int:
    count = 0
    for sample in samples:
        thermal.take(sample)
        count += 1
    return count
