"""What is served: the error map on its way from what was served last to what is wanted now. Pure functions.

A machine must not jump, whatever telemetry, a model or a restart does. `advance` is the only way from a wanted
error map to a served one, `clip` the only way from a solved correction to a commanded one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from model.error_map import ErrorMap
from model.machine import Limits
from model.terms import UM
from model.transforms import Array
from service.reach import Reach, turn_rad

SECOND_ORDER = 0.02
"""Share of the rate kept back for what the first-order bound leaves out: turned levers and directions, which
`MAX_TURN_RAD` keeps below it."""
MAX_REACH = 10.0
"""How many times the absolute limit an error map may be able to correct, in the sum of its terms. What lies beyond
is clipped anyway, and the way back from it would take hours; real maps, whose terms do not add up, stay below."""
MAX_STEEPNESS = 0.1
"""Largest change of the correction per length moved. Real machines have 0.001; far above this the corrected
position would not be unique."""
MAX_TURN_RAD = 0.01
"""Largest sum of angular terms [rad], ten times that of a bad machine."""
LARGEST_TERM = 1000.0
"""Beyond this no term is believed at all [mm, rad]: a metre, or a turn of the whole machine."""
FEW = 4
"""Positions up to which plain Python is faster than arrays."""
ARRIVED_UM = 0.0005
"""Distance from the target that does not count [µm]: half of the 1 nm that compensation promises."""


@dataclass(frozen=True)
class Served:
    """The error map that corrections are computed from.

    Attributes
    ----------
    errors : the map
    time_s : when it was last served, on the clock that the rate limit goes by; never goes back
    remaining_um : bound of how far any correction is from that of the target
    held : whether the target could not be used and the last served map stays
    """

    errors: ErrorMap
    time_s: float
    remaining_um: float
    held: bool = False

    @property
    def arrived(self) -> bool:
        """Whether corrections are those of the target."""
        return self.remaining_um <= ARRIVED_UM and not self.held


@dataclass(frozen=True)
class Target:
    """What is wanted: the geometric part, and the thermal part as far as it is reliable.

    Attributes
    ----------
    geometric, thermal : the two parts; thermal is None where there is none
    weight : 0 ... 1, how much of the thermal part counts
    """

    geometric: ErrorMap
    thermal: ErrorMap | None
    weight: float

    @cached_property
    def errors(self) -> ErrorMap:
        """The sum."""
        if self.thermal is None or not self.weight > 0.0:
            return self.geometric
        return self.geometric + self.thermal.scaled(min(self.weight, 1.0))

    @cached_property
    def usable(self) -> bool:
        """Whether every term is a number, and of a size that a term can have."""
        return is_usable(self.errors)


def advance(served: Served | None, target: Target, now_s: float, limits: Limits, reach: Reach) -> Served:
    """Return what is served now.

    The map moves from the last served one towards the target by a fraction such that no axis' correction, at no
    position, changes faster than `limits.max_rate_um_per_min`. Before anything was served nothing can move, and
    the target is adopted at once. In place of a target that is not usable the last served map stays, or the
    geometric part where there is none.

    Parameters
    ----------
    served : what was served last, None before the first time
    target : the error map wanted
    now_s : on a steady clock [s]; a time before the last counts as the last
    reach : for all tools in use
    """
    if served is None:
        wanted = bounded(target.errors if target.usable else target.geometric, limits, reach)
        remaining_um = _between_um(wanted, target.errors, reach) if target.usable else 0.0
        return Served(wanted, now_s, remaining_um, held=not target.usable)
    now_s = max(now_s, served.time_s)
    if served.errors is target.errors:
        return Served(served.errors, now_s, 0.0)
    if not target.usable:
        return Served(served.errors, now_s, served.remaining_um, held=True)
    wanted = bounded(target.errors, limits, reach)
    step = wanted - served.errors
    allowed_um = limits.max_rate_um_per_min * (now_s - served.time_s) / 60.0 * (1.0 - SECOND_ORDER)
    # The terms are functions of the corrected position: a steep map answers a change with up to 1 / (1 - s) of it.
    allowed_um *= 1.0 - max(reach.steepness(wanted), reach.steepness(served.errors))
    change_um = reach.correction_mm(step) / UM
    moved = wanted if change_um <= allowed_um else served.errors + step.scaled(allowed_um / change_um)
    return Served(moved, now_s, _between_um(moved, target.errors, reach))


def longest_way_s(served: Served, limits: Limits) -> float:
    """Return how long it takes at most to the target that was wanted when this was served, at the rate allowed."""
    slowest = (1.0 - SECOND_ORDER) * (1.0 - MAX_STEEPNESS)
    return served.remaining_um / (limits.max_rate_um_per_min * slowest) * 60.0


def bounded(errors: ErrorMap, limits: Limits, reach: Reach) -> ErrorMap:
    """Return the map, scaled down as a whole where it is too large for the bounds above to hold."""
    excess = max(
        reach.correction_mm(errors) / UM / (MAX_REACH * limits.max_correction_um),
        reach.steepness(errors) / MAX_STEEPNESS,
        turn_rad(errors) / MAX_TURN_RAD,
    )
    return errors if excess <= 1.0 else errors.scaled(1.0 / excess)


def clip(correction_mm: Array, limits: Limits) -> tuple[Array, NDArray[np.bool_]]:
    """Return each axis' correction within the absolute limit, and which points, shape (n,), were clipped."""
    most = limits.max_correction_um * UM
    if len(correction_mm) <= FEW and within(correction_mm, most):
        return correction_mm, np.zeros(len(correction_mm), dtype=np.bool_)
    beyond = np.logical_or.reduce(np.abs(correction_mm) > most, axis=1)
    return np.minimum(np.maximum(correction_mm, -most), most), beyond  # as np.clip, in a third of its time


def within(values: Array, most: float) -> bool:
    """Return whether a few rows of numbers, of shape (n, A), all lie within ±most; NaN does not."""
    return all(-most <= value <= most for row in values.tolist() for value in row)


def is_usable(errors: ErrorMap) -> bool:
    """Return whether every term is a number everywhere, and below `LARGEST_TERM`."""
    # Written so that NaN fails.
    return bool(
        (np.abs(errors.location) < LARGEST_TERM).all()
        and all((np.abs(m) < LARGEST_TERM).all() for m in errors.motion.values())
    )


def _between_um(a: ErrorMap, b: ErrorMap, reach: Reach) -> float:
    return 0.0 if a is b else reach.correction_mm(a - b) / UM
