"""The sensor guard: which readings are plausible. Pure functions; what they remember is passed in and out.

A reading is implausible where it is missing, outside the sensor's range, or further from the last good reading
than the sensor's greatest rate allows. The allowed change grows with the time since that reading, so after a gap a
large change is believed. A first reading is compared with the other sensors instead. A reading that jumped and then
stays at its new level is believed after `CONFIRM_S`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from model.machine import Sensor
from model.sensors import SensorModel
from model.transforms import Array
from service.first_reading import doubtful

NOISE_K = 1.0
"""Change that is always allowed [K]: noise and resolution, which do not shrink with the sampling interval. Chosen:
ten times the noise of a good Pt100 channel."""
CONFIRM_S = 300.0
"""How long a reading must stay at a new level, changing no faster than the sensor can, until it is believed [s].
Chosen: long enough for a person to notice a loose plug, short against the time constants of a structure."""


@dataclass(frozen=True)
class Track:
    """What is remembered of one sensor.

    Attributes
    ----------
    good_degC, good_s : its last plausible reading and when it was
    level_degC, level_s : the last reading at a level it jumped to, None while it is plausible
    level_since_s : when it jumped there
    suggested : whether the last plausible reading is what the other sensors suggest, since there was none yet
    """

    good_degC: float
    good_s: float
    level_degC: float | None = None
    level_s: float = 0.0
    level_since_s: float = 0.0
    suggested: bool = False


@dataclass(frozen=True)
class Judgement:
    """One sample after the guard.

    Attributes
    ----------
    readings : shape (S,) [°C], NaN where there is no plausible reading
    faults : per sensor replaced, why: the end of a sentence that starts with its name
    tracks : what to remember
    """

    readings: Array
    faults: dict[str, str]
    tracks: dict[str, Track]


def judge(
    sensors: Mapping[str, Sensor],
    tracks: Mapping[str, Track],
    time_s: float,
    temperatures: Mapping[str, float | None],
    sensor_model: SensorModel,
) -> Judgement:
    """Check one sample of all `sensors`; a sensor without a reading is missing, other temperatures are ignored."""
    first = _judge(sensors, tracks, time_s, temperatures)
    doubts = doubtful(sensor_model, first.readings, np.array([name not in tracks for name in sensors]))
    if not doubts:
        return first
    names = list(sensors)
    suggested = {names[i]: Track(degC, time_s, suggested=True) for i, degC in doubts.items()}
    return _judge(sensors, {**tracks, **suggested}, time_s, temperatures)


def _judge(
    sensors: Mapping[str, Sensor],
    tracks: Mapping[str, Track],
    time_s: float,
    temperatures: Mapping[str, float | None],
) -> Judgement:
    readings = np.full(len(sensors), np.nan)
    faults: dict[str, str] = {}
    remembered = dict(tracks)
    for index, (name, sensor) in enumerate(sensors.items()):
        reading = temperatures.get(name)
        if reading is None or not math.isfinite(reading):
            faults[name] = "has no reading" if reading is None else f"reads {reading}, which is not a number"
            continue
        track, fault = _judge_reading(sensor, tracks.get(name), time_s, reading)
        if track is not None:
            remembered[name] = track
        if fault is None:
            readings[index] = reading
        else:
            faults[name] = fault
    return Judgement(readings, faults, remembered)


def _judge_reading(
    sensor: Sensor, track: Track | None, time_s: float, reading: float
) -> tuple[Track | None, str | None]:
    low, high = sensor.range_degC
    if not low <= reading <= high:
        return track, f"reads {reading:g} °C, outside {low:g} ... {high:g} °C"
    good = Track(reading, time_s)
    if track is None or _reachable(sensor, track.good_degC, track.good_s, reading, time_s):
        return good, None
    fault = (
        f"reads {reading:g} °C, where the other sensors suggest {track.good_degC:.1f} °C"
        if track.suggested
        else f"jumped by {reading - track.good_degC:+.1f} K in {time_s - track.good_s:.0f} s, "
        f"faster than {sensor.max_rate_degC_per_min:g} K/min"
    )
    if track.level_degC is None or not _reachable(sensor, track.level_degC, track.level_s, reading, time_s):
        return replace(track, level_degC=reading, level_s=time_s, level_since_s=time_s), fault
    if time_s - track.level_since_s >= CONFIRM_S:
        return good, None
    return replace(track, level_degC=reading, level_s=time_s), fault


def _reachable(sensor: Sensor, before_degC: float, before_s: float, reading: float, time_s: float) -> bool:
    allowed = NOISE_K + sensor.max_rate_degC_per_min * max(time_s - before_s, 0.0) / 60.0
    return abs(reading - before_degC) <= allowed
