"""The hall around a machine: level and day, season, heating, layers of warm air, draughts, floor, the chiller.

One thermometer hangs in it. What it does not see is part of what makes thermal errors hard to predict.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.signal import lfilter

from data_synth.climates import Climate
from data_synth.clock import DAY_H, WEEK_H, YEAR_DAYS, Clock
from data_synth.network import Array

BOUNDARIES = ("air_left", "air_right", "air_high", "floor", "chiller")
"""Air low at the machine's left and right, air above, floor, the chiller's supply."""

WARMEST_DAY = 202.0  # late July in central Europe, a month after the longest day (chosen)
WARMEST_HOUR = 15.0  # of a hall's day (chosen)
OUTSIDE_DEGC, OUTSIDE_SEASON_K, OUTSIDE_DAY_K = 10.0, 9.5, 4.0  # central Europe: mean, season, day (chosen)
WEATHER_K, WEATHER_S = 3.0, 2 * 86400.0  # spread and correlation time of its weather (chosen)
HEATED_H = (4.0, 5 * DAY_H + 18.0)  # of the week, where the heating is set back at weekends (chosen)


def surroundings(
    climate: Climate,
    clock: Clock,
    n: int,
    period_s: float,
    rng: np.random.Generator,
    past: int = 0,
    layering: float = 1.0,
) -> Array:
    """Return the boundaries' temperatures over n intervals, columns as in BOUNDARIES, shape (n, 5) [°C].

    Parameters
    ----------
    clock : when the first of them begins
    past : how many of them lie before the run; a heating failure comes after those
    layering : how much of the climate's layering the machine feels
    """
    time = np.arange(n) * period_s
    level = rng.normal(*climate.level_degC) + climate.season_K * season(clock, n, period_s)
    swing = rng.uniform(*climate.day_K) * (1.0 + climate.summer_day * season(clock, n, period_s))
    hall = level + swing * day(clock, n, period_s) + wander(climate.wander_K, climate.wander_s, n, period_s, rng)
    above = layering * (rng.uniform(*climate.layering_K) + wander(0.25, 5400.0, n, period_s, rng))
    air = outside(clock, n, period_s, rng)
    hall = hall + _heating(climate, clock, hall - air, period_s, past, rng)
    cold = _draughts(climate, hall - air, period_s, rng)
    aside = wander(climate.aside_K, 7200.0, n, period_s, rng)
    side = rng.choice([0.25, 1.0])  # the gate is at the left or behind the machine
    floor = level + 0.5 * lag(hall - level, 30000.0, period_s)  # a slab follows within eight hours (chosen)
    ripple = np.abs((time / rng.uniform(400.0, 900.0)) % 2.0 - 1.0) - 0.5  # two-point control
    chiller = hall - 0.5 + 1.2 * ripple + wander(0.6, 5400.0, n, period_s, rng)
    return np.column_stack([hall + aside - cold, hall - (1.25 - side) * cold, hall + above, floor, chiller])


def season(clock: Clock, n: int, period_s: float) -> Array:
    """Return 1 in high summer, -1 in deep winter, shape (n,)."""
    wave: Array = np.cos(2 * np.pi * (clock.days(n, period_s) - WARMEST_DAY) / YEAR_DAYS)
    return wave


def day(clock: Clock, n: int, period_s: float) -> Array:
    """Return 1 at the warmest hour, -1 half a day later, shape (n,)."""
    wave: Array = np.cos(2 * np.pi * (clock.hours(n, period_s) - WARMEST_HOUR) / DAY_H)
    return wave


def outside(clock: Clock, n: int, period_s: float, rng: np.random.Generator) -> Array:
    """Return the temperature outside, shape (n,) [°C]."""
    mean = OUTSIDE_DEGC + OUTSIDE_SEASON_K * season(clock, n, period_s)
    outdoors: Array = mean + OUTSIDE_DAY_K * day(clock, n, period_s) + wander(WEATHER_K, WEATHER_S, n, period_s, rng)
    return outdoors


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


def relax(target: Array, time_constant_s: Array, period_s: float, start: float = 0.0) -> Array:
    """Return what follows held targets with a time constant that may change, shape (n,): after each interval."""
    followed = np.empty(len(target))
    changes = np.flatnonzero(np.diff(time_constant_s)) + 1
    for a, b in pairwise([0, *changes.tolist(), len(target)]):
        if b > a:
            keep = np.exp(-period_s / time_constant_s[a])
            followed[a:b], _ = lfilter([1.0 - keep], [1.0, -keep], target[a:b], zi=[keep * start])
            start = float(followed[b - 1])
    return followed


def _heating(
    climate: Climate, clock: Clock, above_outside_K: Array, period_s: float, past: int, rng: np.random.Generator
) -> Array:
    """Return by how much the hall is colder because its heating is set back or fails, shape (n,) [K].

    Only what the heating holds up can fall: in summer neither does anything.
    """
    n = len(above_outside_K)
    held = np.maximum(above_outside_K, 0.0)
    hour = clock.hours(n, period_s) % WEEK_H
    off = (hour < HEATED_H[0]) | (hour >= HEATED_H[1])
    lowered = -np.minimum(climate.setback_K, held) * off
    set_back = relax(lowered, np.full(n, climate.setback_s), period_s, start=float(lowered[:1].sum()))
    failing = np.zeros(n, dtype=np.bool_)
    begin = past + (n - past) * rng.uniform(0.05, 0.4)
    length = rng.uniform(*climate.failure_h) * 3600.0 / period_s
    failing[int(begin) : int(begin + length)] = True
    pull = np.where(failing, -(held + set_back), 0.0)
    failure = relax(pull, np.where(failing, climate.cooling_s, climate.recovery_s), period_s)
    return set_back + failure


def _draughts(climate: Climate, above_outside_K: Array, period_s: float, rng: np.random.Generator) -> Array:
    n = len(above_outside_K)
    gusts = np.zeros(n)
    count = rng.poisson(climate.draughts_per_h * n * period_s / 3600.0)
    for at in rng.integers(0, max(n, 1), count):
        gusts[at] += rng.uniform(0.3, 1.0)
    share = lfilter([1.0], [1.0, -np.exp(-period_s / climate.draught_s)], gusts)
    cold: Array = climate.draught * np.minimum(share, 1.0) * above_outside_K
    return cold
