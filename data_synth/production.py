"""Duty cycles of production: parts, breaks, shifts, weekends. Durations and speeds are chosen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from data_synth.capability import Pair
from data_synth.clock import DAY_H, WEEK_H, Window
from data_synth.phases import Phase, Plan

SHIFTS: tuple[tuple[Window, ...], ...] = (
    tuple((d * DAY_H + 6.0, d * DAY_H + 14.0) for d in range(5)),
    tuple((d * DAY_H + 6.0, d * DAY_H + 22.0) for d in range(5)),
    ((6.0, 5 * DAY_H + 6.0),),
)
"""One, two and three shifts: when a shop works, in hours of the week."""
UNTIL_FRIDAY: tuple[Window, ...] = ((6.0, 4 * DAY_H + 14.0),)
"""Work from Monday, 6 o'clock, to Friday, 14 o'clock."""
BREAKS: tuple[Window, ...] = ((3.0, 3.25), (5.5, 6.0))
"""Of each shift of eight hours, in hours since its start."""
SHIFT_H = 8.0


def shop(plan: Plan) -> Iterator[Phase]:
    """Job-shop production: batches of parts, each of some operations with its tool, door open at each change."""
    rng = plan.rng
    while True:
        operations = [_operation(plan) for _ in range(int(rng.integers(2, 6)))]
        wear = 1.0
        for _ in range(int(rng.integers(4, 16))):
            for operation in operations:
                wear = wear**0.9 * float(np.exp(rng.normal(0.0, 0.15)))  # a worn edge cuts with more force
                yield replace(operation, load=operation.load * wear)
            yield Phase(rng.uniform(1.0, 4.0), door=True)
        yield Phase(float(rng.choice([8.0, 15.0, 30.0, 60.0])), door=bool(rng.random() < 0.5))  # set-up


def warmup(plan: Plan) -> Iterator[Phase]:
    """A warm-up programme of rising speed with all axes moving, then idling with a few jobs."""
    rng = plan.rng
    for speed in (0.15, 0.3, 0.5, 0.7):
        yield Phase(rng.uniform(5, 12), speed=speed, feeds=dict.fromkeys(plan.axes, 0.3 + 0.4 * speed))
    yield Phase(rng.uniform(60, 240))
    jobs = shop(plan)
    while True:
        for _ in range(int(rng.integers(5, 25))):
            yield next(jobs)
        yield Phase(rng.uniform(40, 150))


def restart(plan: Plan) -> Iterator[Phase]:
    """Work for a few hours, stop, start again."""
    jobs = shop(plan)
    while True:
        yield from _work(jobs, plan.rng.uniform(60, 200))
        yield Phase(plan.rng.uniform(30, 150))


def breaks(plan: Plan) -> Iterator[Phase]:
    """Production with a short break every two hours and a long one every four."""
    jobs = shop(plan)
    while True:
        for rest in (15.0, 45.0):
            yield from _work(jobs, plan.rng.uniform(105, 135))
            yield Phase(rest)


def shifts(plan: Plan) -> Iterator[Phase]:
    """Production in one, two or three shifts from Monday to Friday, with breaks, over the days."""
    at_work = SHIFTS[int(plan.rng.integers(len(SHIFTS)))]
    return _by_calendar(plan, _without_breaks(at_work))


def weekend(plan: Plan) -> Iterator[Phase]:
    """Work until Friday afternoon, cool-down over the weekend, start on Monday morning."""
    return _by_calendar(plan, UNTIL_FRIDAY)


def coolant(plan: Plan) -> Iterator[Phase]:
    """The same cut with coolant and without, for an hour or two each."""
    rng = plan.rng
    while True:
        cut = replace(_operation(plan), minutes=0.0, speed=rng.uniform(0.2, 0.6), tool_change=False)
        for flows in (True, False, True, False):
            yield replace(cut, minutes=rng.uniform(45, 120), coolant=flows)
        yield Phase(rng.uniform(20, 60))


def doors(plan: Plan) -> Iterator[Phase]:
    """Short jobs with the door standing open for long between them, in a draughty hall."""
    jobs = shop(plan)
    while True:
        yield from _work(jobs, plan.rng.uniform(10, 40))
        yield Phase(plan.rng.uniform(10, 40), door=True)


def heating(plan: Plan) -> Iterator[Phase]:
    """Production in the cold season while the hall's heating fails for some hours."""
    return shop(plan)


def night(plan: Plan) -> Iterator[Phase]:
    """Standing under a large swing of the hall, with a short run now and then."""
    rng = plan.rng
    while True:
        yield Phase(rng.uniform(120, 400))
        yield Phase(rng.uniform(5, 40), speed=rng.uniform(0.1, 0.5), feeds=dict.fromkeys(plan.axes, 0.1))


def _work(jobs: Iterator[Phase], minutes: float) -> Iterator[Phase]:
    """Take jobs until so many minutes have passed."""
    while minutes > 0.0:
        phase = next(jobs)
        minutes -= phase.minutes
        yield phase


def _by_calendar(plan: Plan, at_work: tuple[Window, ...]) -> Iterator[Phase]:
    """Work within these windows of the week, stand in between; a job that meets the end goes on afterwards."""
    jobs = shop(plan)
    waiting: Phase | None = None
    hour = plan.clock.hour_of_week
    while True:
        ends = [end for start, end in at_work if start <= hour < end]
        change = ends[0] if ends else min([start for start, _ in at_work if start > hour], default=WEEK_H)
        left = max(0.1, 60.0 * (change - hour))  # some seconds at least, so that rounding cannot halt the clock
        if ends:
            job = waiting or next(jobs)
            phase = replace(job, minutes=min(job.minutes, left))
            waiting = replace(job, minutes=job.minutes - left) if job.minutes > left else None
        else:
            phase = Phase(left)
        hour = (hour + phase.minutes / 60.0) % WEEK_H
        yield phase


def _without_breaks(at_work: tuple[Window, ...]) -> tuple[Window, ...]:
    pieces: list[Window] = []
    for start, end in at_work:
        begin = start
        for shift in np.arange(start, end, SHIFT_H):
            for pause, resume in BREAKS:
                pieces.append((begin, float(shift) + pause))
                begin = float(shift) + resume
        pieces.append((begin, end))
    return tuple(pieces)


def _operation(plan: Plan) -> Phase:
    rng = plan.rng
    # Rotary axes index most parts and move through some cuts.
    moving = (*plan.linear, *(axis for axis in plan.rotary if rng.random() < 0.4))
    return Phase(
        minutes=rng.uniform(1.5, 14.0),
        speed=float(rng.beta(1.4, 2.2)),
        feeds={axis: float(rng.uniform(0.02, 0.5) * rng.choice([0.2, 1.0])) for axis in moving},
        strokes={axis: _stroke(plan, 0.15) for axis in moving},
        coolant=bool(rng.random() < 0.7),
        load=float(rng.gamma(1.5, 0.35)),
        tool_change=True,
    )


def _stroke(plan: Plan, shortest: float) -> Pair:
    width = plan.rng.uniform(shortest, 1.0)
    low = plan.rng.uniform(0.0, 1.0 - width)
    return low, low + width
