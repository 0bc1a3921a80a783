"""Climates by name: from what the surroundings of a run are drawn.

All figures are chosen, for a shop in central Europe without air conditioning unless the name says otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from data_synth.clock import YEAR_DAYS, Window
from model.exceptions import InputError
from model.validation import did_you_mean


@dataclass(frozen=True)
class Climate:
    """A hall and its weather.

    Attributes
    ----------
    level_degC : mean and spread of the hall's level from run to run, the season aside
    season_K : how much warmer than that the hall is in high summer, and colder in deep winter
    day_K : range of the daily swing's amplitude in spring and autumn
    summer_day : share by which the swing is larger in high summer, and smaller in deep winter
    wander_K, wander_s : spread and correlation time of the hall's irregular swing
    aside_K : spread of what the machine's left side differs by: a neighbour, a radiator, the sun
    layering_K : range of how much warmer the air above is
    draughts_per_h : how often the gate opens
    draught, draught_s : share of the difference to the outside that the air at the machine gets at most, and how
        quickly that fades
    setback_K, setback_s : by how much the heating lets the hall cool at weekends, and how quickly it follows
    failure_h : range of how long the heating fails in a run; (0, 0) for never
    cooling_s, recovery_s : how quickly the hall then falls towards the outside, and recovers afterwards
    days : of the year on which runs begin
    """

    level_degC: tuple[float, float] = (20.8, 1.0)
    season_K: float = 1.0
    day_K: tuple[float, float] = (0.5, 2.5)
    summer_day: float = 0.4
    wander_K: float = 0.35
    wander_s: float = 2700.0
    aside_K: float = 0.7
    layering_K: tuple[float, float] = (0.3, 1.8)
    draughts_per_h: float = 0.5
    draught: float = 0.3
    draught_s: float = 1500.0
    setback_K: float = 0.0
    setback_s: float = 4 * 3600.0
    failure_h: tuple[float, float] = (0.0, 0.0)
    cooling_s: float = 20 * 3600.0
    recovery_s: float = 3 * 3600.0
    days: Window = (0.0, YEAR_DAYS)


SHOP = Climate()
SWINGING = replace(SHOP, day_K=(2.5, 4.5), wander_K=0.6)
DRAUGHTY = replace(SHOP, draughts_per_h=2.5)
WEEKLY = replace(SHOP, setback_K=4.0)
HEATING_FAILURE = replace(SHOP, failure_h=(4.0, 10.0), days=(305.0, 435.0))
UNHEATED = replace(SHOP, season_K=7.0, day_K=(1.5, 4.0))
WINTER = replace(SHOP, days=(335.0, 424.0))
SUMMER = replace(SHOP, days=(152.0, 243.0))
CONDITIONED = replace(
    SHOP,
    level_degC=(20.0, 0.2),
    season_K=0.0,
    day_K=(0.1, 0.5),
    wander_K=0.15,
    aside_K=0.2,
    layering_K=(0.1, 0.5),
    draughts_per_h=0.0,
)

CLIMATES: dict[str, Climate] = {
    "shop": SHOP,
    "swinging": SWINGING,
    "draughty": DRAUGHTY,
    "weekly": WEEKLY,
    "heating_failure": HEATING_FAILURE,
    "unheated": UNHEATED,
    "winter": WINTER,
    "summer": SUMMER,
    "conditioned": CONDITIONED,
}


def find(name: str) -> Climate:
    """Return the climate of that name.

    Raises
    ------
    InputError
        where there is none.
    """
    if name not in CLIMATES:
        raise InputError(f"unknown climate '{name}'" + did_you_mean(name, list(CLIMATES)))
    return CLIMATES[name]
