"""One run of a machine: a pure function of (machine, duty cycle, seed)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from data_synth import cycles
from data_synth.design import Design
from data_synth.environment import SHOP, SWINGING, surroundings, wander
from data_synth.fields import Fields, Terms
from data_synth.network import REST, Array
from data_synth.programme import Programme
from model.machine import Machine

PERIOD_S = 60.0  # of telemetry
TERMS_PERIOD_S = 300.0  # of error terms
POSITIONS = 9  # at which motion terms are given
CHANNELS = ("spindle_rpm", "feed_x", "feed_y", "feed_z", "coolant_on")

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
    time_s : since power-on, shape (t,)
    sensors : what each sensor shows, shape (t,) each [°C]
    channels : as in CHANNELS, rpm and mm/min, means over the period before, shape (t,) each
    terms_time_s : shape (u,)
    terms : thermal error terms at those times, relative to the uniform reference temperature
    nodes_degC : true temperatures, shape (t, N); never written
    """

    name: str
    time_s: Array
    sensors: Mapping[str, Array]
    channels: Mapping[str, Array]
    terms_time_s: Array
    terms: Terms
    nodes_degC: Array


def run_kind(index: int) -> str:
    """Return the duty cycle of a data set's run."""
    return cycles.ORDER[index % len(cycles.ORDER)]


def run_name(index: int) -> str:
    """Return the name of a data set's run: its number and its duty cycle."""
    return f"r{index:02d}_{run_kind(index)}"


def simulate(shop: Shop, name: str, kind: str, seed: tuple[int, ...], hours: float) -> Run:
    """Return one run of that duty cycle.

    The machine has a past that nobody logged: it worked for some hours and stood for some, so it starts partly
    warm.
    """
    design = shop.design
    past, plan, weather, dirt, reading = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(5)
    )
    before = _past(design.capability, past)
    programme = cycles.make(kind, design.capability, hours, plan, PERIOD_S).after(before)
    climate = SWINGING if kind == "night" else SHOP
    boundary = surroundings(climate, len(programme), PERIOD_S, weather)
    conditions = [np.exp(wander(CONDITION_SPREAD, CONDITION_S, len(programme), PERIOD_S, dirt)) for _ in design.sources]
    power = design.heat(programme, conditions)
    start = design.network.steady(REST, power[0] * 0.0, boundary[0])
    points, which = programme.operating_points(design.capability.top_rpm)
    nodes = design.network.run(start, points, which, power, boundary, PERIOD_S)
    return _record(shop, name, programme, len(before), nodes, boundary, reading)


def _record(
    shop: Shop,
    name: str,
    programme: Programme,
    skip: int,
    nodes: Array,
    boundary: Array,
    rng: np.random.Generator,
) -> Run:
    design = shop.design
    felt = {node: nodes[skip:, i] for i, node in enumerate(design.network.nodes)}
    around = np.vstack([boundary, boundary[-1:]])[skip:]
    felt |= {name: around[:, i] for i, name in enumerate(design.network.boundaries)}
    sensors = {s: design.thermometers[s].read(felt, PERIOD_S, rng) for s in shop.machine.sensors}
    logged = np.column_stack([programme.speed_rpm, programme.feed_mm_per_min, programme.coolant])[skip:]
    logged = np.vstack([np.zeros((1, logged.shape[1])), logged])
    every = round(TERMS_PERIOD_S / PERIOD_S)
    rise = nodes[skip::every] - shop.machine.reference_temperature_degC
    terms = shop.fields.evaluate(rise, logged[::every, 0])
    time = np.arange(len(logged), dtype=np.float64) * PERIOD_S
    channels = dict(zip(CHANNELS, logged.T, strict=True))
    return Run(name, time, sensors, channels, time[::every], terms, nodes[skip:])


def _past(capability: cycles.Capability, rng: np.random.Generator) -> Programme:
    worked = cycles.make("shop", capability, rng.uniform(0.5, 10.0), rng, PERIOD_S)
    stood = rng.uniform(0.1, 2.0) if rng.random() < 0.35 else rng.uniform(2.0, 14.0)
    return cycles.standing(capability, stood, PERIOD_S).after(worked)
