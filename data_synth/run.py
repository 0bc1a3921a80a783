"""One run of a machine: a pure function of (machine, duty cycle, seed)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_synth import cycles
from data_synth.capability import Capability
from data_synth.climates import Climate
from data_synth.clock import DAY_H, Clock
from data_synth.design import Design
from data_synth.environment import surroundings, wander
from data_synth.faults import Fault, Request, apply
from data_synth.faults import plan as plan_faults
from data_synth.fields import Fields, Terms
from data_synth.network import REST, Array
from data_synth.programme import Programme
from model.exceptions import InputError
from model.machine import Machine

PERIOD_S = 60.0  # of telemetry, unless told otherwise
TERMS_PERIOD_S = 300.0  # of error terms, unless told otherwise
HELD_S = 60.0  # over which programme and surroundings are held; between, temperatures are exact at any period
MOST_ROWS = 60_000  # of a run's telemetry, which is held in memory: 1000 h at one minute, some 100 MB
POSITIONS = 9  # at which motion terms are given

CONDITION_SPREAD, CONDITION_S = 0.15, 4 * 3600.0
"""Friction and losses are never twice the same: spread and correlation time of each source's factor (chosen)."""


@dataclass(frozen=True)
class Shop:
    """A machine with its thermal design, ready to run."""

    machine: Machine
    design: Design
    fields: Fields

    @classmethod
    def of(cls, machine: Machine, design: Design) -> Shop:
        """Return the machine with the error terms of its design worked out."""
        return cls(machine, design, design.structure.fields(machine, design.network.index(), POSITIONS))


@dataclass(frozen=True)
class Run:
    """What one run leaves behind.

    Attributes
    ----------
    clock : when it began
    time_s : since power-on, shape (t,)
    sensors : what each sensor shows, shape (t,) each [°C]
    channels : as named by `channels`; rpm, mm/min and degree/min, means over the period before, shape (t,) each
    terms_time_s : shape (u,)
    terms : thermal error terms at those times, relative to the uniform reference temperature
    nodes_degC : true temperatures, shape (t, N); never written
    faults : of the sensors, in order of time, or None where none were asked for
    """

    name: str
    clock: Clock
    time_s: Array
    sensors: Mapping[str, Array]
    channels: Mapping[str, Array]
    terms_time_s: Array
    terms: Terms
    nodes_degC: Array
    faults: tuple[Fault, ...] | None = None


def channels(machine: Machine) -> tuple[str, ...]:
    """Return the names of the telemetry that is no temperature."""
    return ("spindle_rpm", *(f"feed_{axis.lower()}" for axis in machine.axis_names), "coolant_on")


def run_kind(index: int, order: Sequence[str] = cycles.ORDER) -> str:
    """Return the duty cycle of a data set's run."""
    return order[index % len(order)]


def run_name(index: int, order: Sequence[str] = cycles.ORDER) -> str:
    """Return the name of a data set's run: its number and its duty cycle."""
    return f"r{index:02d}_{run_kind(index, order)}"


def check_period(period_s: float) -> None:
    """Check the period of a run's telemetry.

    Raises
    ------
    InputError
        where it does not go with the minute over which a programme is held.
    """
    shorter, longer = HELD_S / period_s if period_s > 0.0 else 0.0, period_s / HELD_S
    if not (1.0 <= period_s <= 3600.0 and (shorter.is_integer() or longer.is_integer())):
        raise InputError(
            f"period must be 1 to 60 s and divide a minute, or be whole minutes up to an hour, got {period_s:g} s"
        )


def check_periods(period_s: float, terms_period_s: float) -> None:
    """Check the periods of a run's telemetry and error terms.

    Raises
    ------
    InputError
        where a period does not go with the minute over which a programme is held, or with the other.
    """
    check_period(period_s)
    if terms_period_s <= 0.0 or not (terms_period_s / period_s).is_integer():
        raise InputError(f"period of error terms must be a multiple of {period_s:g} s, got {terms_period_s:g} s")


def simulate(
    shop: Shop,
    name: str,
    kind: str,
    seed: tuple[int, ...],
    hours: float,
    period_s: float = PERIOD_S,
    terms_period_s: float = TERMS_PERIOD_S,
    climate: Climate | None = None,
    faults: Request | None = None,
) -> Run:
    """Return one run of that duty cycle, in that climate or in the cycle's own.

    The machine has a past that nobody logged: as a rule it worked for some hours and stood for some, so it starts
    partly warm. The periods only say when it is looked at: the same seed at another period is the same run. Faults
    spoil readings and change nothing else.

    Raises
    ------
    InputError
        where the machine cannot run that cycle, or the periods do not go together.
    """
    check_periods(period_s, terms_period_s)
    design, cycle = shop.design, cycles.find(kind)
    climate = climate or cycle.climate
    past, plan, weather, dirt, reading, calendar, spoiling = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(7)
    )
    clock = Clock.draw(cycle.hours, climate.days, calendar)
    programme, before = _programme(design.capability, kind, hours, clock, plan, past)
    n = len(programme)
    boundary = surroundings(
        climate, clock.later(-before * HELD_S / 3600.0), n, HELD_S, weather, before, design.layering
    )
    conditions = [np.exp(wander(CONDITION_SPREAD, CONDITION_S, n, HELD_S, dirt)) for _ in design.sources]
    power = design.heat(programme, conditions)
    points, which = programme.operating_points(design.capability.top_rpm)
    start = design.network.steady(REST, power[0] * 0.0, boundary[0])
    old, new = slice(0, before), slice(before, n)
    start = design.network.run(start, points, which[old], power[old], boundary[old], HELD_S)[-1]
    fine, coarse = max(1, round(HELD_S / period_s)), max(1, round(period_s / HELD_S))
    which, power, held = which[new].repeat(fine), power[new].repeat(fine, axis=0), boundary[new].repeat(fine, axis=0)
    nodes = design.network.run(start, points, which, power, held, HELD_S / fine)[::coarse]
    periods = (period_s, terms_period_s)
    run = _record(shop, name, clock, programme.part(new), nodes, boundary[new], periods, reading, seed[0])
    if faults is None:
        return run
    spoilt = plan_faults(name, tuple(run.sensors), run.time_s, faults, spoiling)
    return replace(run, sensors=apply(run.sensors, run.time_s, spoilt), faults=spoilt)


def _programme(
    capability: Capability, cycle: str, hours: float, clock: Clock, plan: np.random.Generator, past: np.random.Generator
) -> tuple[Programme, int]:
    """Return the run's programme with what was before it, and how many intervals that is."""
    how = cycles.find(cycle).past
    if how == "same":  # the calendar says what was before
        n = round(cycles.PAST_H * 3600.0 / HELD_S)
        earlier = clock.later(-cycles.PAST_H)
        return cycles.make(cycle, capability, cycles.PAST_H + hours, plan, HELD_S, earlier), n
    if how == "rest":
        before = cycles.standing(capability, cycles.PAST_H, HELD_S)
    else:
        worked = cycles.make("shop", capability, past.uniform(0.5, 10.0), past, HELD_S)
        stood = past.uniform(0.1, 2.0) if past.random() < 0.35 else past.uniform(2.0, 14.0)
        before = cycles.standing(capability, stood, HELD_S).after(worked)
    return cycles.make(cycle, capability, hours, plan, HELD_S, clock).after(before), len(before)


def _record(
    shop: Shop,
    name: str,
    clock: Clock,
    programme: Programme,
    nodes: Array,
    boundary: Array,
    periods_s: tuple[float, float],
    rng: np.random.Generator,
    seed: int,
) -> Run:
    design = shop.design
    period_s, terms_period_s = periods_s
    fine, coarse = max(1, round(HELD_S / period_s)), max(1, round(period_s / HELD_S))
    around = np.vstack([np.repeat(boundary, fine, axis=0), boundary[-1:]])[::coarse]
    felt = dict(zip((*design.network.nodes, *design.network.boundaries), np.hstack([nodes, around]).T, strict=True))
    sensors = {}
    for sensor in shop.machine.sensors:
        meter = design.thermometers[sensor]
        # All thermometers are checked on New Year's Day, so the day of the year is their age.
        off = meter.calibrated(f"{shop.machine.name}/{sensor}", seed, clock.day_of_year * DAY_H)
        sensors[sensor] = meter.read(felt, period_s, rng, off)
    told = np.column_stack([programme.speed_rpm, programme.feed_per_min, programme.coolant])
    told = np.vstack([np.zeros((1, told.shape[1])), np.repeat(told, fine, axis=0)])
    means = told[1 : 1 + (len(nodes) - 1) * coarse].reshape(len(nodes) - 1, coarse, -1).mean(axis=1)
    logged = np.vstack([told[:1], means])
    time = np.arange(len(nodes), dtype=np.float64) * period_s
    every = round(terms_period_s / period_s)
    rise = nodes[::every] - shop.machine.reference_temperature_degC
    terms = shop.fields.evaluate(rise, told[:: every * coarse, 0])
    return Run(
        name=name,
        clock=clock,
        time_s=time,
        sensors=sensors,
        channels=dict(zip(channels(shop.machine), logged.T, strict=True)),
        terms_time_s=time[::every],
        terms=terms,
        nodes_degC=nodes,
    )
