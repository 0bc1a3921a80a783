"""Whether probed deviations leave the interval that predictions promise: a sequential test. Pure functions.

What is compared is the residual, measured minus predicted, less what it was at the same place at first: a constant
offset is geometry, the artefact's or the probe's, and no drift. A thermal prediction is wrong for as long as the
thermal state that it is wrong in, so probings close in time count as one session, and only sessions are taken to be
independent. The running residual is their exponentially weighted mean. It is a sum of the sessions' errors with known
weights, so its standard deviation follows from those that the bundle promises, first probings and datum included, and
under these the machine is called drifting in at most `FALSE_ALARMS` of sessions.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from model.transforms import Array

SESSION_S = 4 * 3600.0
"""Probings within this time count as one [s]. Chosen: half a shift, longer than most thermal states last."""
REFERENCE = 8
"""Sessions at a place whose mean is its reference: fewer would pass too much of their own error on to all later ones.
With these a shift of three standard deviations is found within ten sessions, nearly always."""
MEMORY = 0.2
"""Weight of the newest session in the running residual: five sessions, about a day (Roberts, Technometrics 1, 1959)."""
FALSE_ALARMS = 0.001
"""Largest share of sessions in which a machine that is as predicted is called drifting."""
COMPONENTS = 3
LIMIT_SD = NormalDist().inv_cdf(1.0 - FALSE_ALARMS / (2 * COMPONENTS))
"""From so many standard deviations of the running residual on, in any component: 3.59."""
SAME_PLACE_MM = 1.0
"""Positions are the same place where they agree to this on each axis [mm]."""
DAY_S = 86400.0


@dataclass(frozen=True)
class Compared:
    """A probed deviation and the prediction of that moment.

    Attributes
    ----------
    time_s : when it was probed
    place : position on the machine's axes [mm]
    residual_um : measured minus predicted in x, y and z; NaN where not measured
    sd_um : standard deviation that the bundle promises for it, the probe's own included
    datum_sd_um : that of the prediction at the datum, which all later ones share; 0 without one
    datum_s : when that was; None where deviations are absolute
    """

    time_s: float
    place: tuple[float, ...]
    residual_um: tuple[float, float, float]
    sd_um: float
    datum_sd_um: float = 0.0
    datum_s: float | None = None


@dataclass(frozen=True)
class Component:
    """One direction of the tip.

    Attributes
    ----------
    running_um : running residual; None until a place has been probed in more than `REFERENCE` sessions
    limit_um : what it stays within, unless the machine drifts
    trend_um_per_day, trend_sd_um_per_day : slope of the residual and its standard error; None below three sessions
    sessions : that were compared
    """

    running_um: float | None = None
    limit_um: float | None = None
    trend_um_per_day: float | None = None
    trend_sd_um_per_day: float | None = None
    sessions: int = 0

    @property
    def drifting(self) -> bool:
        """Whether the running residual has left its interval."""
        return self.running_um is not None and self.limit_um is not None and abs(self.running_um) > self.limit_um


@dataclass(frozen=True)
class Drift:
    """What probed deviations say of a machine, in x, y and z."""

    components: tuple[Component, Component, Component] = (Component(), Component(), Component())

    @property
    def drifting(self) -> bool:
        """Whether any component has left its interval."""
        return any(c.drifting for c in self.components)


def assess(compared: Iterable[Compared]) -> Drift:
    """Return what comparisons of one model say, in any order of time."""
    sessions = _sessions(sorted(compared, key=lambda c: c.time_s))
    x, y, z = (_component(sessions, k) for k in range(COMPONENTS))
    return Drift((x, y, z))


def _sessions(compared: Sequence[Compared]) -> list[list[Compared]]:
    sessions: list[list[Compared]] = []
    for one in compared:
        if not sessions or one.time_s - sessions[-1][0].time_s >= SESSION_S:
            sessions.append([])
        sessions[-1].append(one)
    return sessions


Place = tuple[bool, tuple[int, ...]]


def _component(sessions: Sequence[Sequence[Compared]], k: int) -> Component:
    measured = [m for m in ([c for c in s if math.isfinite(c.residual_um[k])] for s in sessions) if m]
    means = [_by_place(s, k) for s in measured]
    references: dict[Place, list[int]] = {}
    for number, places in enumerate(means):
        for place in places:
            known = references.setdefault(place, [])
            if len(known) < REFERENCE:
                known.append(number)
    offset = {p: _mean([means[n][p] for n in known]) for p, known in references.items()}
    # Of each session, its places whose reference was complete before it.
    later = [[p for p in places if n > references[p][-1]] for n, places in enumerate(means)]
    counted = [n for n, places in enumerate(later) if places]
    trend, trend_sd = _trend(measured, means, offset)
    if not counted:
        return Component(None, None, trend, trend_sd, len(measured))
    weights = MEMORY * (1.0 - MEMORY) ** np.arange(len(counted) - 1, -1, -1.0)
    weights /= weights.sum()
    running = 0.0
    share = np.zeros(len(measured))  # of each session's error in the running residual
    for weight, n in zip(weights.tolist(), counted, strict=True):
        compared = later[n]
        running += weight * _mean([means[n][p] - offset[p] for p in compared])
        share[n] += weight
        for p in compared:
            share[references[p]] -= weight / len(compared) / len(references[p])
    return Component(running, LIMIT_SD * _deviation(measured, share), trend, trend_sd, len(measured))


def _deviation(measured: Sequence[Sequence[Compared]], share: Array) -> float:
    """Return the standard deviation of a sum of sessions' errors with these weights [µm].

    Within a session errors are taken to be the same, and so are those of a datum in all that refers to it.
    """
    variance = float(sum(w**2 * max(c.sd_um for c in s) ** 2 for w, s in zip(share, measured, strict=True)))
    datums: dict[float, tuple[float, float]] = {}
    for weight, session in zip(share.tolist(), measured, strict=True):
        first = session[0]
        if first.datum_s is not None:
            total, sd = datums.get(first.datum_s, (0.0, 0.0))
            datums[first.datum_s] = total + weight, max([sd, *(c.datum_sd_um for c in session)])
    return math.sqrt(variance + sum((weight * sd) ** 2 for weight, sd in datums.values()))


def _by_place(session: Sequence[Compared], k: int) -> dict[Place, float]:
    """Return the mean residual of a session at each place [µm]; absolute ones and those since a datum are apart."""
    values: dict[Place, list[float]] = {}
    for one in session:
        place = one.datum_s is None, tuple(round(p / SAME_PLACE_MM) for p in one.place)
        values.setdefault(place, []).append(one.residual_um[k])
    return {place: _mean(v) for place, v in values.items()}


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def _trend(
    measured: Sequence[Sequence[Compared]], means: Sequence[dict[Place, float]], offset: dict[Place, float]
) -> tuple[float | None, float | None]:
    """Return the slope of the sessions' residuals and its standard error, by least squares [µm/day]."""
    if len(measured) < 3:
        return None, None
    days = np.array([_mean([c.time_s for c in s]) for s in measured]) / DAY_S
    values = np.array([_mean([v - offset[p] for p, v in places.items()]) for places in means])
    days -= days.mean()
    spread = float((days**2).sum())
    slope = float((days * values).sum()) / spread
    left = values - values.mean() - slope * days
    return slope, math.sqrt(float((left**2).sum()) / (len(days) - 2) / spread)
