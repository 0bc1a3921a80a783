"""Faults of sensors, on request and labelled: what a log shows when a cable, a clamp or an input fails.

The kinds are those that studies of real sensor networks find: missing and constant readings, short and lasting jumps
(Sharma, Golubchik and Govindan, ACM Trans. Sensor Networks 6(3), 2010; de Bruijn et al., SENSORNETS 2016), and cables
exchanged at service. How often they come and how long they last is chosen: far more often than in a shop, so that a
data set shows each.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_synth.network import Array
from model.exceptions import InputError
from model.validation import did_you_mean

HOUR_S = 3600.0


@dataclass(frozen=True)
class Habit:
    """How a kind of fault comes.

    Attributes
    ----------
    per_100h : how often, in 100 hours of a healthy sensor, unless asked otherwise
    lasts_s : shortest and longest, log-uniform between; at least one reading
    size_K : smallest and largest, log-uniform between
    down : share that reads too low
    """

    per_100h: float
    lasts_s: tuple[float, float]
    size_K: tuple[float, float] | None = None
    down: float = 0.5


KINDS: Mapping[str, Habit] = {
    "dropout": Habit(1.0, (30.0, 2 * HOUR_S)),  # a lost telegram to a broken contact
    "stuck": Habit(0.5, (0.5 * HOUR_S, 24 * HOUR_S)),  # a hung input
    "spike": Habit(2.0, (0.0, 0.0), (5.0, 100.0)),  # a contactor beside the cable
    "offset": Habit(0.5, (HOUR_S, 24 * HOUR_S), (0.5, 5.0), 0.75),  # a loose clamp: nearer to the air, mostly colder
    "swapped": Habit(0.1, (math.inf, math.inf)),  # two cables exchanged, to the end of the run
}

MOST_PER_100H = 1000.0  # ten an hour (chosen): with more there is hardly a healthy reading left
SIZE_STEP_K = 0.1  # as readings are rounded
SWAPPED_BEFORE = 0.5
"""Share of exchanged cables that are so from the run's start (chosen)."""


@dataclass(frozen=True)
class Fault:
    """One fault of one sensor; of exchanged cables each has one.

    Attributes
    ----------
    kind : "dropout": no reading; "stuck": the reading before it, held; "spike": a single wild reading; "offset": all
        readings moved; "swapped": the other sensor's readings
    start_s, end_s : times of its first and its last reading, since power-on
    magnitude_K : of a spike or an offset, shown minus healthy: +2 K shows 22 °C for 20 °C
    other : of exchanged cables, the other sensor
    """

    run: str
    sensor: str
    kind: str
    start_s: float
    end_s: float
    magnitude_K: float | None = None
    other: str | None = None

    def cells(self, time_s: Array) -> NDArray[np.bool_]:
        """Return which readings are faulty, shape (t,)."""
        return (self.start_s <= time_s) & (time_s <= self.end_s)


@dataclass(frozen=True)
class Request:
    """Which kinds of faults, and how many in 100 hours of a healthy sensor."""

    per_100h: Mapping[str, float]

    @property
    def text(self) -> str:
        """As on the command line; `parse` gives the same request back."""
        return ",".join(f"{kind}={np.format_float_positional(rate, trim='-')}" for kind, rate in self.per_100h.items())


def parse(text: str) -> Request:
    """Read a request such as "dropout,stuck=2,spike", or "all"; a kind without a number comes at its usual rate.

    Raises
    ------
    InputError
        with one sentence, where a kind is unknown or stands twice, or a rate makes no sense.
    """
    if text.strip() == "all":
        return Request({kind: habit.per_100h for kind, habit in KINDS.items()})
    rates: dict[str, float] = {}
    for item in text.split(","):
        kind, given, rate = (part.strip() for part in item.partition("="))
        if kind not in KINDS:
            raise InputError(
                f"faults must be kinds such as 'dropout,stuck=2', or 'all', got '{kind}'{did_you_mean(kind, [*KINDS])}"
            )
        if kind in rates:
            raise InputError(f"fault '{kind}' must be named once, got it twice in '{text}'")
        rates[kind] = _rate(kind, rate) if given else KINDS[kind].per_100h
    return Request({kind: rates[kind] for kind in KINDS if kind in rates})


def _rate(kind: str, text: str) -> float:
    try:
        rate = float(text)
    except ValueError:
        rate = math.nan
    if not 0.0 < rate <= MOST_PER_100H:
        raise InputError(
            f"fault '{kind}' must come more than 0 and at most {MOST_PER_100H:g} times in 100 hours of a sensor, "
            f"got '{text}'"
        )
    return rate


def plan(
    run: str, sensors: Sequence[str], time_s: Array, request: Request, rng: np.random.Generator
) -> tuple[Fault, ...]:
    """Return a run's faults, in order of time.

    A sensor has one fault at a time and a healthy reading between two, and starts healthy unless its cable was
    exchanged before; so each sensor has readings in each run. Kinds are drawn apart: asking for one more moves no
    other, but where both would befall one sensor.

    Parameters
    ----------
    time_s : of the readings, rising, shape (t,)
    """
    healthy_from = dict.fromkeys(sensors, 0)
    faults: list[Fault] = []
    for candidate in sorted(_candidates(sensors, time_s, request, rng), key=lambda c: c.start_s):
        first = int(np.searchsorted(time_s, candidate.start_s))
        last = max(first, int(np.searchsorted(time_s, candidate.start_s + candidate.lasts_s)) - 1)
        if any(first < healthy_from[sensor] for sensor in candidate.sensors):
            continue
        healthy_from |= dict.fromkeys(candidate.sensors, last + 2)
        # One fault of one sensor, or two that name each other.
        for sensor, other in zip(candidate.sensors, candidate.sensors[::-1], strict=True):
            start_s, end_s = float(time_s[first]), float(time_s[last])
            swapped = other if other != sensor else None
            faults.append(Fault(run, sensor, candidate.kind, start_s, end_s, candidate.magnitude_K, swapped))
    return tuple(faults)


def apply(readings: Mapping[str, Array], time_s: Array, faults: Sequence[Fault]) -> dict[str, Array]:
    """Return the readings (t,) with the faults; those given stay as they are."""
    shown = {sensor: values.copy() for sensor, values in readings.items()}
    for fault in faults:
        cells = fault.cells(time_s)
        shown[fault.sensor][cells] = _faulty(fault, readings, cells)
    return shown


@dataclass(frozen=True)
class _Candidate:
    """A fault that happens if its sensors, one or two, are healthy when it comes."""

    kind: str
    sensors: tuple[str, ...]
    start_s: float
    lasts_s: float
    magnitude_K: float | None


def _candidates(
    sensors: Sequence[str], time_s: Array, request: Request, rng: np.random.Generator
) -> Iterator[_Candidate]:
    """Yield faults as Poisson processes; leaving out those of faulty sensors leaves the rate of healthy ones."""
    sensor_hours = len(sensors) * (time_s[-1] - time_s[0]) / HOUR_S
    for (kind, habit), own in zip(KINDS.items(), rng.spawn(len(KINDS)), strict=True):
        size = 2 if kind == "swapped" else 1
        if len(sensors) < size:
            continue
        # Two sensors have the fault of one exchange.
        for _ in range(own.poisson(request.per_100h.get(kind, 0.0) * sensor_hours / 100.0 / size)):
            hit = tuple(sensors[i] for i in own.choice(len(sensors), size, replace=False))
            start = float(own.uniform(time_s[0], time_s[-1]))
            if kind == "swapped" and own.random() < SWAPPED_BEFORE:
                start = float(time_s[0])
            yield _Candidate(kind, hit, start, _log_uniform(habit.lasts_s, own), _magnitude(habit, own))


def _magnitude(habit: Habit, rng: np.random.Generator) -> float | None:
    if habit.size_K is None:
        return None
    sign = -1.0 if rng.random() < habit.down else 1.0
    return sign * round(round(_log_uniform(habit.size_K, rng) / SIZE_STEP_K) * SIZE_STEP_K, 6)


def _log_uniform(ends: tuple[float, float], rng: np.random.Generator) -> float:
    low, high = ends
    return low if low == high else float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _faulty(fault: Fault, readings: Mapping[str, Array], cells: NDArray[np.bool_]) -> Array | float:
    own = readings[fault.sensor]
    if fault.kind == "dropout":
        return math.nan
    if fault.kind == "stuck":
        return float(own[max(int(np.argmax(cells)) - 1, 0)])
    if fault.other is not None:
        return readings[fault.other][cells]
    assert fault.magnitude_K is not None
    moved: Array = np.round(own[cells] + fault.magnitude_K, 6)
    return moved
