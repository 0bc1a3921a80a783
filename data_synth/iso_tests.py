"""Duty cycles that test one thing at a time.

`etve`, `spindle`, `axes` and `rotary` follow the spirit of the four tests of ISO 230-3:2020 (environmental
temperature variation; distortion by a rotating spindle, by moving linear axes, by rotary motion of components);
durations, speeds and feeds are chosen.
"""

from __future__ import annotations

from collections.abc import Iterator

from data_synth.phases import Phase, Plan

SPEEDS = (0.0, 0.15, 0.25, 0.4, 0.5, 0.6, 0.75, 1.0)
HOUR = 60.0  # minutes


def etve(plan: Plan) -> Iterator[Phase]:
    """At rest under the hall's day (ISO 230-3, environmental temperature variation: 24 h or more)."""
    while True:
        yield Phase(plan.rng.uniform(4 * HOUR, 8 * HOUR))


def spindle(plan: Plan) -> Iterator[Phase]:
    """Four hours of one speed or of a speed spectrum, then two hours of standstill (ISO 230-3, rotating spindle)."""
    rng = plan.rng
    while True:
        if rng.random() < 0.5:
            yield Phase(4 * HOUR, speed=rng.uniform(0.5, 1.0))
        else:
            for _ in range(16):
                yield Phase(15.0, speed=float(rng.choice(SPEEDS)))
        yield Phase(2 * HOUR)


def steps(plan: Plan) -> Iterator[Phase]:
    """Constant speeds for one to three hours each, some of them zero."""
    rng = plan.rng
    while True:
        yield Phase(rng.uniform(60, 180), speed=rng.uniform(0.15, 0.85))
        if rng.random() < 0.4:
            yield Phase(rng.uniform(45, 120))


def constant(plan: Plan) -> Iterator[Phase]:
    """One speed all the time."""
    speed = plan.rng.uniform(0.3, 0.9)
    while True:
        yield Phase(24 * HOUR, speed=speed)


def spectrum(plan: Plan) -> Iterator[Phase]:
    """Speeds of some minutes each, then a stop, again and again."""
    rng = plan.rng
    while True:
        for _ in range(int(rng.integers(12, 24))):
            yield Phase(rng.uniform(2, 15), speed=float(rng.choice(SPEEDS)))
        yield Phase(rng.uniform(45, 120))


def axes(plan: Plan) -> Iterator[Phase]:
    """One linear axis at a time to and fro between two points, then rest (ISO 230-3, moving linear axes)."""
    return _one_at_a_time(plan, plan.linear)


def rotary(plan: Plan) -> Iterator[Phase]:
    """One rotary axis at a time to and fro, then rest (ISO 230-3, rotary motion of components)."""
    return _one_at_a_time(plan, plan.rotary)


def _one_at_a_time(plan: Plan, which: tuple[str, ...]) -> Iterator[Phase]:
    rng = plan.rng
    while True:
        for k in rng.permutation(len(which)):
            width = rng.uniform(0.5, 1.0)
            low = rng.uniform(0.0, 1.0 - width)
            yield Phase(
                rng.uniform(45, 120),
                feeds={which[k]: rng.uniform(0.25, 0.8)},
                strokes={which[k]: (low, low + width)},
            )
            yield Phase(rng.uniform(10, 60))
