"""Duty cycles, seeded and named: what a shop and ISO 230-3:2020 make a machine do.

Each cycle is a generator of phases; `make` writes them into a programme of a given length. Durations and speeds
are chosen; the tests follow the spirit of ISO 230-3 (environment, rotating spindle, moving linear axes).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from data_synth.network import Array
from data_synth.programme import Programme

Pair = tuple[float, float]


@dataclass(frozen=True)
class Capability:
    """What a programme may ask of a machine: spindle speed, mean feed, and the strokes of X, Y, Z."""

    top_rpm: float
    top_feed_mm_per_min: float
    strokes_mm: tuple[Pair, Pair, Pair]


@dataclass(frozen=True)
class Phase:
    """A stretch of a duty cycle; `strokes` as shares of the axes' strokes."""

    minutes: float
    speed: float = 0.0  # share of the top speed
    feeds: tuple[float, float, float] = (0.0, 0.0, 0.0)  # share of the top feed
    strokes: tuple[Pair, Pair, Pair] = ((0.0, 1.0), (0.0, 1.0), (0.0, 1.0))
    coolant: bool = False
    door: bool = False
    load: float = 0.0


Cycle = Callable[[np.random.Generator], Iterator[Phase]]


def steps(rng: np.random.Generator) -> Iterator[Phase]:
    """Constant speeds for one to three hours each, some of them zero (ISO 230-3, rotating spindle)."""
    while True:
        yield Phase(rng.uniform(60, 180), speed=rng.uniform(0.15, 0.85))
        if rng.random() < 0.4:
            yield Phase(rng.uniform(45, 120))


def spectrum(rng: np.random.Generator) -> Iterator[Phase]:
    """A spindle speed spectrum: speeds of some minutes each, then a stop (ISO 230-3, rotating spindle)."""
    while True:
        for _ in range(int(rng.integers(12, 24))):
            yield Phase(rng.uniform(2, 15), speed=rng.choice([0.0, 0.15, 0.25, 0.4, 0.5, 0.6, 0.75, 1.0]))
        yield Phase(rng.uniform(45, 120))


def axes(rng: np.random.Generator) -> Iterator[Phase]:
    """One axis at a time to and fro, then rest (ISO 230-3, moving linear axes)."""
    while True:
        for axis in rng.permutation(3):
            feeds = [0.0, 0.0, 0.0]
            feeds[axis] = rng.uniform(0.25, 0.8)
            yield Phase(rng.uniform(45, 120), feeds=(feeds[0], feeds[1], feeds[2]), strokes=_strokes(rng, 0.5))
            yield Phase(rng.uniform(10, 60))


def shop(rng: np.random.Generator) -> Iterator[Phase]:
    """Job-shop production: batches of parts, each of some operations with its tool, door open at each change."""
    while True:
        operations = [_operation(rng) for _ in range(int(rng.integers(2, 6)))]
        wear = 1.0
        for _ in range(int(rng.integers(4, 16))):
            for operation in operations:
                wear = wear**0.9 * float(np.exp(rng.normal(0.0, 0.15)))  # a worn edge cuts with more force
                yield Phase(**{**operation.__dict__, "load": operation.load * wear})
            yield Phase(rng.uniform(1.0, 4.0), door=True)
        yield Phase(float(rng.choice([8.0, 15.0, 30.0, 60.0])), door=bool(rng.random() < 0.5))  # set-up, breaks


def warmup(rng: np.random.Generator) -> Iterator[Phase]:
    """A warm-up programme of rising speed with all axes moving, then idling with a few jobs."""
    for speed in (0.15, 0.3, 0.5, 0.7):
        feed = 0.3 + 0.4 * speed
        yield Phase(rng.uniform(5, 12), speed=speed, feeds=(feed, feed, feed))
    yield Phase(rng.uniform(60, 240))
    jobs = shop(rng)
    while True:
        for _ in range(int(rng.integers(5, 25))):
            yield next(jobs)
        yield Phase(rng.uniform(40, 150))


def restart(rng: np.random.Generator) -> Iterator[Phase]:
    """Work for a few hours, stop, start again."""
    jobs = shop(rng)
    while True:
        until = rng.uniform(60, 200)
        while until > 0:
            phase = next(jobs)
            until -= phase.minutes
            yield phase
        yield Phase(rng.uniform(30, 150))


def night(rng: np.random.Generator) -> Iterator[Phase]:
    """Standing under a large swing of the ambient (ISO 230-3, ETVE), with a short run now and then."""
    while True:
        yield Phase(rng.uniform(120, 400))
        yield Phase(rng.uniform(5, 40), speed=rng.uniform(0.1, 0.5), feeds=(0.1, 0.1, 0.1))


CYCLES: dict[str, Cycle] = {
    "shop": shop,
    "steps": steps,
    "spectrum": spectrum,
    "axes": axes,
    "warmup": warmup,
    "restart": restart,
    "night": night,
}
ORDER = ("shop", "steps", "spectrum", "axes", "shop", "warmup", "restart", "night")
"""In which the runs of a data set take their duty cycles: production twice as often as each test."""


def make(
    kind: str, capability: Capability, hours: float, rng: np.random.Generator, period_s: float = 60.0
) -> Programme:
    """Return a duty cycle of that length."""
    n = round(hours * 3600 / period_s)
    low, high = np.array(capability.strokes_mm).T
    speed, load = np.zeros(n), np.zeros(n)
    feed = np.zeros((n, 3))
    stroke = np.tile(np.stack([low, high]), (n, 1, 1))
    coolant, door = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    at = 0
    for phase in CYCLES[kind](rng):
        if at >= n:
            break
        rows = slice(at, min(n, at + max(1, round(phase.minutes * 60 / period_s))))
        speed[rows] = phase.speed
        feed[rows] = phase.feeds
        stroke[rows] = low + (high - low) * np.array(phase.strokes).T
        coolant[rows], door[rows], load[rows] = phase.coolant, phase.door, phase.load
        at = rows.stop
    speed_rpm = np.rint(speed * capability.top_rpm)
    feed_mm_per_min = np.rint(_unsteady(feed, 0.15, rng) * capability.top_feed_mm_per_min)
    return Programme(
        kind,
        period_s,
        speed_rpm,
        feed_mm_per_min,
        stroke[:, 0],
        stroke[:, 1],
        coolant,
        door,
        _unsteady(load, 0.25, rng),
    )


def standing(capability: Capability, hours: float, period_s: float = 60.0) -> Programme:
    """Return a programme in which nothing moves."""
    n = round(hours * 3600 / period_s)
    low, high = np.array(capability.strokes_mm).T
    zero, never = np.zeros(n), np.zeros(n, dtype=np.bool_)
    return Programme(
        "off", period_s, zero, np.zeros((n, 3)), np.tile(low, (n, 1)), np.tile(high, (n, 1)), never, never, zero
    )


def _operation(rng: np.random.Generator) -> Phase:
    feeds = rng.uniform(0.02, 0.5, 3) * rng.choice([0.2, 1.0], 3)
    return Phase(
        minutes=rng.uniform(1.5, 14.0),
        speed=float(rng.beta(1.4, 2.2)),
        feeds=(float(feeds[0]), float(feeds[1]), float(feeds[2])),
        strokes=_strokes(rng, 0.15),
        coolant=bool(rng.random() < 0.7),
        load=float(rng.gamma(1.5, 0.35)),
    )


def _strokes(rng: np.random.Generator, shortest: float) -> tuple[Pair, Pair, Pair]:
    strokes = []
    for _ in range(3):
        width = rng.uniform(shortest, 1.0)
        low = rng.uniform(0.0, 1.0 - width)
        strokes.append((low, low + width))
    return (strokes[0], strokes[1], strokes[2])


def _unsteady(values: Array, spread: float, rng: np.random.Generator) -> Array:
    """Return the values with a factor of that spread from interval to interval; zero stays zero."""
    unsteady: Array = values * np.exp(rng.normal(0.0, spread, values.shape))
    return unsteady
