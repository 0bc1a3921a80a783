"""Duty cycles, seeded and named: what a shop and ISO 230-3:2020 make a machine do.

Each is a generator of phases in iso_tests.py or production.py; this file says which there are, in which climate
and at which hours each runs, and in which order a data set takes them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from data_synth import climates, iso_tests, production
from data_synth.capability import Capability
from data_synth.climates import Climate
from data_synth.clock import DAY_H, MONDAY_MORNING, WEEK_H, Clock, Window
from data_synth.phases import Phase, Phases, Plan, write
from data_synth.programme import Programme
from model.exceptions import InputError
from model.machine import Machine
from model.structure import LINEAR_AXES, ROTARY_AXES
from model.validation import did_you_mean

ANY_HOUR: tuple[Window, ...] = ((0.0, WEEK_H),)
WORKDAYS: tuple[Window, ...] = tuple((d * DAY_H, d * DAY_H + 10.0) for d in range(5))
AROUND_WEEKEND: tuple[Window, ...] = ((4 * DAY_H + 4.0, 4 * DAY_H + 12.0), (0.0, 5.0))
"""Friday morning or the early hours of Monday, so that half a day shows the cool-down or the start."""


PAST_H = 24.0  # before a run whose past is rest or more of the same (chosen): all but the bed forgets within a day


@dataclass(frozen=True)
class Cycle:
    """A duty cycle.

    Attributes
    ----------
    climate : the hall it runs in, unless told otherwise
    hours : windows of the week in which a run of it begins
    past : what the machine did before the run: some hours of production and of standing, nothing, or the same
    """

    phases: Phases
    climate: Climate = climates.SHOP
    hours: tuple[Window, ...] = ANY_HOUR
    past: Literal["production", "rest", "same"] = "production"


CYCLES: dict[str, Cycle] = {
    "shop": Cycle(production.shop),
    "steps": Cycle(iso_tests.steps),
    "spectrum": Cycle(iso_tests.spectrum),
    "axes": Cycle(iso_tests.axes),
    "warmup": Cycle(production.warmup),
    "restart": Cycle(production.restart),
    "night": Cycle(production.night, climates.SWINGING),
    "constant": Cycle(iso_tests.constant),
    "spindle": Cycle(iso_tests.spindle),
    "rotary": Cycle(iso_tests.rotary),
    "etve": Cycle(iso_tests.etve, climates.SWINGING, past="rest"),
    "coolant": Cycle(production.coolant),
    "doors": Cycle(production.doors, climates.DRAUGHTY),
    "breaks": Cycle(production.breaks),
    "shifts": Cycle(production.shifts, climates.WEEKLY, WORKDAYS, past="same"),
    "weekend": Cycle(production.weekend, climates.WEEKLY, AROUND_WEEKEND, past="same"),
    "heating": Cycle(production.heating, climates.HEATING_FAILURE),
}
NAMES: tuple[str, ...] = tuple(CYCLES)
"""All duty cycles, in the order of help and card."""
ORDER: tuple[str, ...] = (
    *("shop", "steps", "spectrum", "axes", "shop", "warmup", "restart", "night"),
    *("shop", "spindle", "constant", "shifts", "shop", "coolant", "heating", "etve"),
    *("shop", "doors", "breaks", "axes", "shop", "weekend", "steps", "shop"),
)
"""In which the runs of a data set take their duty cycles: mostly production, each test at least once."""


def order(machine: Machine) -> tuple[str, ...]:
    """Return the order of a machine's data sets: one with rotary axes turns them in place of a second test of axes."""
    if not any(axis.rotary for axis in machine.axes.values()):
        return ORDER
    second = [k for k, name in enumerate(ORDER) if name == "axes"][1]
    return (*ORDER[:second], "rotary", *ORDER[second + 1 :])


def find(name: str) -> Cycle:
    """Return the duty cycle of that name.

    Raises
    ------
    InputError
        where there is none.
    """
    if name not in CYCLES:
        raise InputError(f"unknown duty cycle '{name}'" + did_you_mean(name, list(CYCLES)))
    return CYCLES[name]


def describe(name: str) -> str:
    """Return one line on a duty cycle, for help and card."""
    return (find(name).phases.__doc__ or "").splitlines()[0].rstrip(".")


def check(name: str, axes: Iterable[str]) -> None:
    """Check that a machine with these axes can run the duty cycle of that name.

    Raises
    ------
    InputError
        where there is no such cycle, or it moves axes that the machine has not.
    """
    axes = tuple(axes)
    wants, what = {"rotary": (ROTARY_AXES, "a rotary"), "axes": (LINEAR_AXES, "a linear")}.get(name, (axes, "an"))
    find(name)
    if not set(axes) & set(wants):
        raise InputError(f"duty cycle '{name}' must have {what} axis to move, got {', '.join(axes)}; leave it out")


def make(
    kind: str,
    capability: Capability,
    hours: float,
    rng: np.random.Generator,
    period_s: float = 60.0,
    clock: Clock = MONDAY_MORNING,
) -> Programme:
    """Return a duty cycle of that length, which begins at that moment.

    Raises
    ------
    InputError
        where there is no such cycle, or it moves axes that the machine has not.
    """
    check(kind, capability.axes)
    drawn, unsteady = rng.spawn(2)  # apart, so that a longer programme begins as a shorter one
    plan = Plan(capability.linear, capability.rotary, clock, drawn)
    return write(kind, CYCLES[kind].phases(plan), capability, round(hours * 3600 / period_s), period_s, unsteady)


def standing(capability: Capability, hours: float, period_s: float = 60.0) -> Programme:
    """Return a programme in which nothing moves."""
    n = round(hours * 3600 / period_s)
    return write("off", itertools.repeat(Phase(WEEK_H * 60.0)), capability, n, period_s, np.random.default_rng(0))
