"""The sensor guard: which readings are plausible. Pure functions; what they remember is passed in and out.

A reading is implausible where

- it is missing, or outside the sensor's range;
- it is further from the last good reading than the sensor's greatest rate allows, or moves so against the others. The
  allowed change grows with the time since that reading, so after a gap a large change is believed;
- it stands still while the other sensors say that it should have moved: it is stuck;
- it is far from what the other sensors suggest, further than anything a new season does, or two readings make sense
  only the other way round.

A reading that was not believed is believed again once it agrees with the other sensors, and either could have come from
the last good reading or has stayed at its new level for `CONFIRM_S`. A first reading has to agree, too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from model.machine import Sensor
from model.transforms import Array
from service.agreement import Agreement
from service.first_reading import doubtful

NOISE_K = 1.0
"""Change that is always allowed [K]: noise and resolution, which do not shrink with the sampling interval. Chosen:
ten times the noise of a good Pt100 channel."""
CONFIRM_S = 300.0
"""How long a reading must stay at a new level, changing no faster than the sensor can, until it is believed [s].
Chosen: long enough for a person to notice a loose plug, short against the time constants of a structure."""
AGAINST = 0.25
"""Share of its greatest rate that a sensor may move against what the others' changes suggest (chosen: the synthetic
machines' sensors stay below a third of the limit that this gives at one sample a minute)."""
AGREE_SD, AGREE_K = 4.0, 2.0
"""A reading agrees with the others up to so many standard deviations, or so many kelvin, whichever is more (chosen)."""
STRANGEST, UNLIKE = 2.0, 4.0
"""How many times further a strange day lets it be, at most; and from where on the others are so unlike training that
they tell nothing (chosen: synthetic machines come to 3.4)."""
FAR_SD, FAR_K = 12.0, 5.0
"""A reading that did not jump is not believed only beyond this: halls colder than any in training have brought healthy
sensors of a synthetic machine to 12 (bench/fault_week.py)."""
CARRY_S = 600.0
"""How long a reading that is lost is carried on from its last one, as the others suggest it has changed [s]. A sensor
is apart from its estimate in its own way for hours, so a lost telegram must not move the correction (chosen)."""
FEW = 0.25
"""Share of sensors, but at least one, that have to agree with the others before they are believed again. Where more are
out at once, the machine may be what is unlike training and not they, so time alone decides (chosen)."""
FROZEN_K = 0.05
"""A reading that stays within this has not moved [K]: half of the tenth that PLC words carry."""
STUCK_S = 600.0
"""How long a reading must not have moved to be taken for stuck [s] (chosen)."""
STUCK_SD, STUCK_K = 4.0, 2.0
"""And how far it should have moved meanwhile, in its usual distances from what the others suggest, and at least in
kelvin: a sensor of coarse resolution in a calm shop stands still for hours, rightly (chosen)."""


@dataclass(frozen=True)
class Track:
    """What is remembered of one sensor.

    Attributes
    ----------
    good_degC, good_s : its last plausible reading and when it was
    level_degC, level_s : the last reading that was not believed, None while it is plausible
    level_since_s : since when it has been at that level
    suggested : whether the last reading taken for plausible was not, and there is none to carry on from
    frozen_degC, frozen_s : a reading from which it has not moved since then; None before the first
    moved_K : how far it should have moved meanwhile, as the other sensors suggest
    apart_K : its last plausible reading less what the other sensors suggested then
    """

    good_degC: float
    good_s: float
    level_degC: float | None = None
    level_s: float = 0.0
    level_since_s: float = 0.0
    suggested: bool = False
    frozen_degC: float | None = None
    frozen_s: float = 0.0
    moved_K: float = 0.0
    apart_K: float = 0.0


@dataclass(frozen=True)
class Judgement:
    """One sample after the guard.

    Attributes
    ----------
    readings : shape (S,) [°C], NaN where there is no plausible reading
    faults : per sensor replaced, why: the end of a sentence that starts with its name
    tracks : what to remember
    carried : the readings with those that were lost a short while ago carried on, shape (S,) [°C]
    """

    readings: Array
    faults: dict[str, str]
    tracks: dict[str, Track]
    carried: Array


def judge(
    sensors: Mapping[str, Sensor],
    tracks: Mapping[str, Track],
    time_s: float,
    temperatures: Mapping[str, float | None],
    agreement: Agreement,
) -> Judgement:
    """Check one sample of all `sensors`; a sensor without a reading is missing, other temperatures are ignored."""
    if not sensors:
        return Judgement(np.empty(0), {}, {}, np.empty(0))
    names = list(sensors)
    readings, faults = _measured(sensors, temperatures)
    remembered = dict(tracks)
    # Those that were believed last time can be compared with each other; the others have to find back to them.
    believed = np.array([_is_believed(tracks.get(name)) for name in names], dtype=bool)
    first = np.isfinite(readings) & np.array([name not in tracks for name in names], dtype=bool)
    doubts = doubtful(agreement.sensor_model, np.where(believed, readings, np.nan), first) if first.any() else {}
    for i, degC in doubts.items():
        remembered[names[i]] = Track(degC, time_s, suggested=True)
        faults[names[i]] = f"reads {readings[i]:g} °C, where the other sensors suggest {degC:.1f} °C"
        remembered[names[i]] = _apart(remembered[names[i]], time_s, float(readings[i]), sensors[names[i]])
        believed[i] = False
    _check_rates(sensors, remembered, time_s, np.where(believed, readings, np.nan), faults)
    _check_changes(sensors, remembered, time_s, _left(names, readings, believed, faults), faults, agreement)
    _check_distances(sensors, remembered, time_s, _left(names, readings, believed, faults), faults, agreement)
    kept = _left(names, readings, believed, faults)
    out = int(np.isfinite(readings).sum() - np.isfinite(kept).sum())
    few = out <= max(1.0, FEW * len(names))
    for i, name in enumerate(names):
        if math.isfinite(readings[i]) and not believed[i] and name not in faults:
            _return(sensors[name], remembered, name, time_s, i, (readings, kept), faults, agreement if few else None)
    for i, name in enumerate(names):
        if name in faults:
            readings[i] = np.nan
    apart = agreement.distances(readings)[0].tolist()
    for i, name in enumerate(names):
        if name not in faults:
            track = remembered[name]
            frozen = (track.frozen_degC, track.frozen_s, track.moved_K)
            remembered[name] = _good(float(readings[i]), time_s, frozen, apart[i])
    carried = _carried(sensors, remembered, time_s, readings, agreement) if faults else readings
    return Judgement(readings, faults, remembered, carried)


def _good(reading: float, time_s: float, frozen: tuple[float | None, float, float], apart_K: float) -> Track:
    """Return the track of a reading that is believed."""
    frozen_degC, frozen_s, moved_K = frozen
    return Track(reading, time_s, frozen_degC=frozen_degC, frozen_s=frozen_s, moved_K=moved_K, apart_K=apart_K)


def _carried(
    sensors: Mapping[str, Sensor], tracks: Mapping[str, Track], time_s: float, readings: Array, agreement: Agreement
) -> Array:
    """Return the readings with those lost for at most `CARRY_S` carried on, as far from the others as they were."""
    found = readings.copy()
    for i, (name, sensor) in enumerate(sensors.items()):
        track = tracks.get(name)
        if not math.isnan(readings[i]) or track is None or track.suggested or time_s - track.good_s > CARRY_S:
            continue
        known = readings.copy()
        known[i] = track.good_degC
        now_K = float(agreement.distances(known)[0][i])
        # Where no other sensor is known, it stays as it was.
        change_K = track.apart_K - now_K if np.isfinite(readings).any() else 0.0
        found[i] = min(max(track.good_degC + change_K, sensor.range_degC[0]), sensor.range_degC[1])
    return found


def _measured(sensors: Mapping[str, Sensor], temperatures: Mapping[str, float | None]) -> tuple[Array, dict[str, str]]:
    """Return the readings that a sensor can have, NaN for others, and why not."""
    readings = np.full(len(sensors), np.nan)
    faults: dict[str, str] = {}
    for i, (name, sensor) in enumerate(sensors.items()):
        reading, (low, high) = temperatures.get(name), sensor.range_degC
        if reading is None:
            faults[name] = "has no reading"
        elif not math.isfinite(reading):
            faults[name] = f"reads {reading}, which is not a number"
        elif not low <= reading <= high:
            faults[name] = f"reads {reading:g} °C, outside {low:g} ... {high:g} °C"
        else:
            readings[i] = reading
    return readings, faults


def _is_believed(track: Track | None) -> bool:
    return track is None or track.level_degC is None


def _left(names: list[str], readings: Array, believed: Array, faults: Mapping[str, str]) -> Array:
    """Return the readings that are believed and have no fault so far, NaN for the others."""
    return np.where(believed & np.array([name not in faults for name in names], dtype=bool), readings, np.nan)


def _check_rates(
    sensors: Mapping[str, Sensor],
    tracks: dict[str, Track],
    time_s: float,
    readings: Array,
    faults: dict[str, str],
) -> None:
    """Find readings that no sensor of this kind can have reached."""
    for reading, (name, sensor) in zip(readings.tolist(), sensors.items(), strict=True):
        track = tracks.get(name)
        if (
            track is None
            or not math.isfinite(reading)
            or _reachable(sensor, track.good_degC, track.good_s, reading, time_s)
        ):
            continue
        faults[name] = (
            f"jumped by {reading - track.good_degC:+.1f} K in {time_s - track.good_s:.0f} s, "
            f"faster than {sensor.max_rate_degC_per_min:g} K/min"
        )
        tracks[name] = _apart(track, time_s, reading, sensor)


def _check_changes(
    sensors: Mapping[str, Sensor],
    tracks: dict[str, Track],
    time_s: float,
    readings: Array,
    faults: dict[str, str],
    agreement: Agreement,
) -> None:
    """Find readings that moved against the others, and those that stood still while they should have moved.

    Only sensors believed at the same last moment are compared: changes over different times mean nothing.
    """
    names = list(sensors)
    last_s = max((tracks[n].good_s for n in names if n in tracks), default=math.inf)
    fresh = [n in tracks and tracks[n].good_s == last_s for n in names]
    before = np.array([tracks[n].good_degC if f else np.nan for n, f in zip(names, fresh, strict=True)])
    dt_s = time_s - last_s
    changes = readings - before
    allowed = np.array([NOISE_K + AGAINST * s.max_rate_degC_per_min * max(dt_s, 0.0) / 60.0 for s in sensors.values()])
    while True:  # the worst first: a wrong one makes its neighbours look wrong, too
        surprise, usual = agreement.surprises(changes)
        if not (np.abs(surprise) > allowed).any():
            break
        i = int((np.abs(surprise) / usual).argmax())  # the likeliest to be the wrong one, if one is
        name = names[i]
        faults[name] = f"moved by {changes[i]:+.1f} K in {dt_s:.0f} s, {surprise[i]:+.1f} K against the other sensors"
        tracks[name] = _apart(tracks[name], time_s, float(readings[i]), sensors[name])
        changes[i] = np.nan
    suggested = (changes - surprise).tolist()
    for i, (name, reading) in enumerate(zip(names, readings.tolist(), strict=True)):
        if not math.isfinite(reading) or name in faults:
            continue
        tracks[name] = track = _stood(tracks.get(name), time_s, reading, suggested[i])
        if time_s - track.frozen_s >= STUCK_S and abs(track.moved_K) > max(STUCK_K, STUCK_SD * float(usual[i])):
            faults[name] = _stuck(track, time_s)
            tracks[name] = _unlike(track, time_s, reading, sensors[name])


def _check_distances(
    sensors: Mapping[str, Sensor],
    tracks: dict[str, Track],
    time_s: float,
    readings: Array,
    faults: dict[str, str],
    agreement: Agreement,
) -> None:
    """Find two readings that are exchanged, or the one that is furthest beyond belief; the next one next time."""
    pair = agreement.exchanged(readings)
    if pair is not None:
        names = list(sensors)
        for i, other in (pair, pair[::-1]):
            faults[names[i]] = f"reads {readings[i]:g} °C, as if exchanged with sensor '{names[other]}'"
            tracks[names[i]] = _unlike(tracks.get(names[i]), time_s, float(readings[i]), sensors[names[i]])
        return
    distance, usual = agreement.distances(readings)
    i = int((np.abs(distance) / usual).argmax())
    if abs(distance[i]) > max(FAR_K, FAR_SD * usual[i]):
        name = list(sensors)[i]
        faults[name] = _far(float(readings[i]), float(distance[i]))
        tracks[name] = _unlike(tracks.get(name), time_s, float(readings[i]), sensors[name])


def _return(
    sensor: Sensor,
    tracks: dict[str, Track],
    name: str,
    time_s: float,
    index: int,
    both: tuple[Array, Array],
    faults: dict[str, str],
    agreement: Agreement | None,
) -> None:
    """Believe a reading again that was not believed, or say why not.

    Parameters
    ----------
    both : all readings, and those that are believed
    agreement : with which the reading has to agree; None where too many are not believed to ask them
    """
    reading, known = float(both[0][index]), both[1].copy()
    known[index] = reading
    distance, usual = 0.0, math.inf
    if agreement is not None:
        distances, usuals = agreement.distances(known)
        distance, strange = float(distances[index]), float(usuals[index])
        plain = float(agreement.distances(known, 1.0)[1][index])
        usual = min(strange, STRANGEST * plain) if strange < UNLIKE * plain else math.inf
    track = tracks[name] = _apart(tracks[name], time_s, reading, sensor)
    if _has_not_moved(track, reading) and abs(track.moved_K) > STUCK_K and time_s - track.frozen_s >= STUCK_S:
        faults[name] = _stuck(track, time_s)
    elif abs(distance) > max(AGREE_K, AGREE_SD * usual):
        faults[name] = _far(reading, distance)
    elif (
        not _reachable(sensor, track.good_degC, track.good_s, reading, time_s)
        and time_s - track.level_since_s < CONFIRM_S
    ):
        faults[name] = f"jumped to {reading:g} °C, and has been there for {time_s - track.level_since_s:.0f} s"


def _apart(track: Track, time_s: float, reading: float, sensor: Sensor) -> Track:
    """Return the track with a reading that is not believed."""
    known = track.level_degC
    follows = known is not None and _reachable(sensor, known, track.level_s, reading, time_s)
    since_s = track.level_since_s if follows else time_s
    return replace(track, level_degC=reading, level_s=time_s, level_since_s=since_s)


def _unlike(track: Track | None, time_s: float, reading: float, sensor: Sensor) -> Track:
    """Return the track, from now on, of a reading that is unlike what the other sensors suggest."""
    known = Track(reading, time_s) if track is None else track
    return replace(_apart(known, time_s, reading, sensor), suggested=True)


def _stood(track: Track | None, time_s: float, reading: float, suggested_K: float) -> Track:
    """Return the track with how long a believed reading has not moved, and how far it should have."""
    if track is None:
        return Track(reading, time_s, frozen_degC=reading, frozen_s=time_s)
    stood = _has_not_moved(track, reading)
    moved_K = track.moved_K + (suggested_K if math.isfinite(suggested_K) else 0.0) if stood else 0.0
    frozen = (track.frozen_degC, track.frozen_s) if stood else (reading, time_s)
    return Track(
        track.good_degC,
        track.good_s,
        suggested=track.suggested,
        frozen_degC=frozen[0],
        frozen_s=frozen[1],
        moved_K=moved_K,
    )


def _has_not_moved(track: Track, reading: float) -> bool:
    return track.frozen_degC is not None and abs(reading - track.frozen_degC) <= FROZEN_K


def _stuck(track: Track, time_s: float) -> str:
    minutes = (time_s - track.frozen_s) / 60.0
    return f"has shown {track.frozen_degC:g} °C for {minutes:.0f} min, while the others say {track.moved_K:+.1f} K"


def _far(reading: float, distance: float) -> str:
    return f"reads {reading:g} °C, where the other sensors suggest {reading - distance:.1f} °C"


def _reachable(sensor: Sensor, before_degC: float, before_s: float, reading: float, time_s: float) -> bool:
    allowed = NOISE_K + sensor.max_rate_degC_per_min * max(time_s - before_s, 0.0) / 60.0
    return abs(reading - before_degC) <= allowed
