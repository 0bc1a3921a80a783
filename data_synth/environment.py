"""The hall around a machine: level and day, heating, layers of warm air, draughts, floor, the spindle chiller.

One thermometer hangs in it. What it does not see is part of what makes thermal errors hard to predict.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from data_synth.network import Array

DAY_S = 86400.0

BOUNDARIES = ("air_left", "air_right", "air_high", "floor", "chiller")
"""Air low at the machine's left and right, air above, floor, the chiller's supply."""


@dataclass(frozen=True)
class Climate:
    """From what a run's surroundings are drawn; all chosen for a shop without air conditioning.

    Attributes
    ----------
    level_degC : mean and spread of the hall's level from run to run
    day_K : range of the daily swing's amplitude
    wander_K, wander_s : spread and correlation time of the hall's irregular swing
    aside_K : spread of what the machine's left side differs by: a neighbour, a radiator, the sun
    layering_K : range of how much warmer the air above is
    draughts_per_h, draught_K, draught_s : how often the gate opens, how much colder one side of the machine
        gets at most, and how quickly that fades
    """

    level_degC: tuple[float, float] = (20.8, 1.2)
    day_K: tuple[float, float] = (0.5, 2.5)
    wander_K: float = 0.35
    wander_s: float = 2700.0
    aside_K: float = 0.7
    layering_K: tuple[float, float] = (0.3, 1.8)
    draughts_per_h: float = 0.5
    draught_K: float = 4.0
    draught_s: float = 1500.0


SHOP = Climate()
SWINGING = Climate(day_K=(2.5, 4.5), wander_K=0.6)


def surroundings(climate: Climate, n: int, period_s: float, rng: np.random.Generator) -> Array:
    """Return the boundaries' temperatures over n intervals, columns as in BOUNDARIES, shape (n, 5) [°C]."""
    time = np.arange(n) * period_s
    level = rng.normal(*climate.level_degC)
    swing = rng.uniform(*climate.day_K) * np.sin(2 * np.pi * (time / DAY_S + rng.random()))
    hall = level + swing + wander(climate.wander_K, climate.wander_s, n, period_s, rng)
    layering = rng.uniform(*climate.layering_K) + wander(0.25, 5400.0, n, period_s, rng)
    cold = _draughts(climate, n, period_s, rng)
    aside = wander(climate.aside_K, 7200.0, n, period_s, rng)
    side = rng.choice([0.25, 1.0])  # the gate is at the left or behind the machine
    floor = level + 0.5 * lag(hall - level, 30000.0, period_s)  # a slab follows within eight hours (chosen)
    ripple = np.abs((time / rng.uniform(400.0, 900.0)) % 2.0 - 1.0) - 0.5  # two-point control
    chiller = hall - 0.5 + 1.2 * ripple + wander(0.6, 5400.0, n, period_s, rng)
    return np.column_stack([hall + aside - cold, hall - (1.25 - side) * cold, hall + layering, floor, chiller])


def wander(spread: float, correlation_s: float, n: int, period_s: float, rng: np.random.Generator) -> Array:
    """Return an Ornstein-Uhlenbeck path: spread and correlation time do not depend on the period."""
    keep = np.exp(-period_s / correlation_s)
    kicks = rng.normal(0.0, spread * np.sqrt(1.0 - keep**2), n)
    kicks[:1] = rng.normal(0.0, spread, len(kicks[:1]))
    path: Array = lfilter([1.0], [1.0, -keep], kicks)
    return path


def lag(values: Array, time_constant_s: float, period_s: float) -> Array:
    """Return what a first-order lag makes of values that run straight between samples, from their first one.

    Exact for such values (first-order hold), for any period.
    """
    if time_constant_s <= 0.0:
        return values
    x = period_s / time_constant_s
    keep = np.exp(-x)
    mean = (1.0 - keep) / x
    now, before = 1.0 - mean, mean - keep
    lagged, _ = lfilter([now, before], [1.0, -keep], values[1:], zi=[(before + keep) * values[0]])
    return np.concatenate([values[:1], lagged])


def _draughts(climate: Climate, n: int, period_s: float, rng: np.random.Generator) -> Array:
    gusts = np.zeros(n)
    count = rng.poisson(climate.draughts_per_h * n * period_s / 3600.0)
    for at in rng.integers(0, max(n, 1), count):
        gusts[at] += climate.draught_K * rng.uniform(0.3, 1.0)
    cold: Array = lfilter([1.0], [1.0, -np.exp(-period_s / climate.draught_s)], gusts)
    return cold
