"""Stretches of a duty cycle, and how they are written into a programme."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from data_synth.capability import Capability, Pair
from data_synth.clock import Clock
from data_synth.network import Array
from data_synth.programme import Programme

FEED_SPREAD = 0.15  # of the mean feed from interval to interval (chosen)
LOAD_SPREAD = 0.25  # of the cutting load from interval to interval (chosen)


@dataclass(frozen=True)
class Phase:
    """A stretch of a duty cycle; what moves and cuts as shares of what the machine can.

    Attributes
    ----------
    speed : share of the top speed
    feeds : share of the top feed, of the axes that move
    strokes : between which shares of its stroke an axis moves; the whole stroke of those not named
    tool_change : the spindle runs up from standstill even if it ran before
    """

    minutes: float
    speed: float = 0.0
    feeds: Mapping[str, float] = field(default_factory=dict)
    strokes: Mapping[str, Pair] = field(default_factory=dict)
    coolant: bool = False
    door: bool = False
    load: float = 0.0
    tool_change: bool = False


@dataclass(frozen=True)
class Plan:
    """What a duty cycle is written for: the machine's axes, the moment it begins, its own random stream."""

    linear: tuple[str, ...]
    rotary: tuple[str, ...]
    clock: Clock
    rng: np.random.Generator

    @property
    def axes(self) -> tuple[str, ...]:
        """All axes."""
        return self.linear + self.rotary


Phases = Callable[[Plan], Iterator[Phase]]


def write(
    kind: str,
    phases: Iterator[Phase],
    capability: Capability,
    n: int,
    period_s: float,
    rng: np.random.Generator,
) -> Programme:
    """Return n intervals of a duty cycle; a phase ends with the interval its end is nearest to."""
    top_feed, low, high = capability.columns()
    axes = capability.axes
    speed, starts, load = np.zeros(n), np.zeros(n), np.zeros(n)
    feed = np.zeros((n, len(axes)))
    stroke = np.tile(np.stack([low, high]), (n, 1, 1))
    coolant, door = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    at, until_s, running = 0, 0.0, 0.0
    while at < n:
        phase = next(phases)
        until_s += phase.minutes * 60.0
        end = min(n, int(until_s / period_s + 0.5))
        if end == at:
            continue  # too short to be seen
        rows = slice(at, end)
        speed[rows] = phase.speed
        starts[at] = phase.speed > 0.0 and (phase.tool_change or running == 0.0)
        feed[rows] = [phase.feeds.get(axis, 0.0) for axis in axes]
        stroke[rows] = low + (high - low) * np.array([phase.strokes.get(axis, (0.0, 1.0)) for axis in axes]).T
        coolant[rows], door[rows], load[rows] = phase.coolant, phase.door, phase.load
        at, running = end, phase.speed
    return Programme(
        kind,
        period_s,
        axes,
        np.rint(speed * capability.top_rpm),
        starts,
        np.minimum(np.rint(_unsteady(feed, FEED_SPREAD, rng) * top_feed), top_feed),
        stroke[:, 0],
        stroke[:, 1],
        coolant,
        door,
        _unsteady(load, LOAD_SPREAD, rng),
    )


def _unsteady(values: Array, spread: float, rng: np.random.Generator) -> Array:
    """Return the values with a factor of that spread from interval to interval; zero stays zero."""
    unsteady: Array = values * np.exp(rng.normal(0.0, spread, values.shape))
    return unsteady
