from dataclasses import replace

import numpy as np
import pytest

from data_synth import cycles
from data_synth.climates import (
    CLIMATES,
    CONDITIONED,
    DRAUGHTY,
    HEATING_FAILURE,
    SHOP,
    SUMMER,
    SWINGING,
    UNHEATED,
    WEEKLY,
    WINTER,
    find,
)
from data_synth.clock import DAY_H, WEEK_H, Clock
from data_synth.environment import BOUNDARIES, day, outside, relax, season, surroundings
from data_synth.machines import open_shop
from data_synth.run import simulate
from model.exceptions import InputError

PERIOD_S = 60.0
DAY = 1440
JANUARY, JULY = Clock(0.0, 20.0), Clock(0.0, 202.0)
CALM = replace(
    SHOP,
    level_degC=(20.0, 0.0),
    season_K=0.0,
    day_K=(0.0, 0.0),
    wander_K=0.0,
    aside_K=0.0,
    draughts_per_h=0.0,
)


def air(climate, clock=JANUARY, days=2.0, seed=0, past=0):
    """Return the boundaries by name."""
    columns = surroundings(climate, clock, round(days * DAY), PERIOD_S, np.random.default_rng(seed), past).T
    return dict(zip(BOUNDARIES, columns, strict=True))


def halls(climate, clock=JANUARY, days=1.0, seeds=40):
    return np.array([air(climate, clock, days, seed)["air_right"] for seed in range(seeds)])


def test_a_calm_hall_holds_its_level():
    calm = air(CALM)
    np.testing.assert_allclose(calm["air_left"], 20.0)
    np.testing.assert_allclose(calm["air_right"], 20.0)
    np.testing.assert_allclose(calm["floor"], 20.0)


def test_the_season_shifts_the_level_by_its_share():
    climate = replace(CALM, season_K=3.0)
    for clock, wave in ((JULY, 1.0), (Clock(0.0, (202.0 + 182.5) % 365.0), -1.0)):
        np.testing.assert_allclose(air(climate, clock)["air_right"], 20.0 + wave * 3.0, atol=2e-3)


def test_summer_days_swing_more():
    climate = replace(CALM, day_K=(2.0, 2.0), summer_day=0.5)
    swings = [np.ptp(air(climate, clock)["air_right"]) for clock in (JANUARY, JULY)]
    assert swings[1] == pytest.approx(6.0, rel=1e-3)
    assert swings[0] == pytest.approx(2.0, rel=0.02)


def test_the_afternoon_is_warmest_whenever_the_run_begins():
    climate = replace(CALM, day_K=(2.0, 2.0))
    for start in (0.0, 7.5, 100.25):
        warm = air(climate, Clock(start, 100.0), days=1.0)["air_right"]
        hour = (start + np.argmax(warm) / 60.0) % DAY_H
        assert hour == pytest.approx(15.0, abs=0.05)


def test_outside_is_cold_in_winter_and_at_night():
    rng = np.random.default_rng(0)
    winter, summer = (outside(clock, 60 * DAY, PERIOD_S, rng) for clock in (Clock(0.0, 355.0), Clock(0.0, 172.0)))
    assert winter.mean() + 12.0 < summer.mean()
    afternoon = day(JANUARY, 60 * DAY, PERIOD_S) > 0.9
    assert winter[afternoon].mean() > winter[~afternoon].mean() + 2.0
    assert season(JULY, 1, PERIOD_S)[0] == pytest.approx(1.0)


def test_relaxing_is_exponential_and_does_not_depend_on_the_period():
    for period_s in (10.0, 60.0, 600.0):
        n = round(7200 / period_s)
        target, tau = np.full(2 * n, -8.0), np.full(2 * n, 5000.0)
        target[n:], tau[n:] = 0.0, 2500.0
        got = relax(target, tau, period_s)
        assert got[n - 1] == pytest.approx(-8.0 * (1.0 - np.exp(-7200 / 5000.0)))
        assert got[-1] == pytest.approx(got[n - 1] * np.exp(-7200 / 2500.0))


def test_a_failing_heating_lets_the_hall_fall_towards_the_outside_and_recover():
    climate = replace(CALM, failure_h=(8.0, 8.0), cooling_s=12 * 3600.0, recovery_s=3 * 3600.0)
    for seed in range(10):
        past, n = DAY, 3 * DAY
        hall = air(climate, JANUARY, n / DAY, seed, past)["air_right"]
        cooling = np.flatnonzero(np.diff(hall) < -1e-9)
        assert cooling[0] >= past - 1  # before it nothing happens
        np.testing.assert_allclose(hall[: cooling[0]], 20.0)
        assert len(cooling) == pytest.approx(8 * 60, abs=1)
        assert np.ptp(cooling) == len(cooling) - 1  # one fall, then it rises
        # Outside it is -3 to 8 °C: of that difference, 1 - exp(-8 / 12) is lost.
        lost = 20.0 - hall.min()
        assert 12.0 * 0.45 < lost < 25.0 * 0.52
        after = hall[cooling[-1] + 1 :]
        np.testing.assert_allclose(20.0 - after[180], lost * np.exp(-1.0), rtol=0.02)


def test_no_failing_heating_is_felt_when_it_is_as_warm_outside():
    cold = halls(replace(CALM, failure_h=(8.0, 8.0)), JULY)
    assert 20.0 - cold.min() < 0.35 * (20.0 - halls(replace(CALM, failure_h=(8.0, 8.0))).min())
    warm_outside = replace(CALM, failure_h=(8.0, 8.0), level_degC=(0.0, 0.0))
    np.testing.assert_allclose(halls(warm_outside, JULY, seeds=5), 0.0, atol=1e-12)


def test_a_heating_set_back_leaves_the_weekend_cold():
    climate = replace(CALM, setback_K=4.0)
    hall = air(climate, Clock(0.0, 14.0), days=7.0)["air_right"]
    hour = np.arange(len(hall)) / 60.0
    np.testing.assert_allclose(hall[(hour > 3 * DAY_H) & (hour < 5 * DAY_H + 18.0)], 20.0, atol=0.1)
    assert hall[(hour > 6.5 * DAY_H)].max() < 16.3
    assert air(climate, Clock(WEEK_H - 1.0, 14.0), days=0.01)["air_right"][0] == pytest.approx(16.0)


def test_a_draught_chills_one_side_or_both_by_at_most_its_share():
    climate = replace(CALM, draughts_per_h=6.0)
    shares = set()
    for seed in range(8):
        there = air(climate, days=5.0, seed=seed)
        sides = np.array([20.0 - there["air_left"], 20.0 - there["air_right"]])
        assert (sides >= -1e-9).all()
        assert 2.0 < sides.max() < climate.draught * 32.0
        right = (sides[1].sum() / sides[0].sum()).round(9)
        np.testing.assert_allclose(sides[1], right * sides[0], atol=1e-9)
        shares.add(right)
    assert shares == {0.25, 1.0}


def test_draughts_are_stronger_in_winter_and_more_frequent_in_a_draughty_hall():
    def chill(climate, clock):
        return float(np.mean([20.0 - air(climate, clock, 2.0, seed)["air_left"].mean() for seed in range(20)]))

    often, seldom = (replace(CALM, draughts_per_h=c.draughts_per_h) for c in (DRAUGHTY, SHOP))
    assert chill(often, JANUARY) > 2.0 * chill(seldom, JANUARY)
    assert chill(often, JANUARY) > 3.0 * chill(often, JULY)


def test_the_climates_differ_as_their_names_say():
    within = {name: halls(climate).std(axis=1).mean() for name, climate in CLIMATES.items()}
    assert within["conditioned"] < 0.5 * within["shop"]
    assert within["shop"] < 0.8 * within["swinging"]
    failing, heated = (halls(replace(c, draughts_per_h=0.0)).min(axis=1).mean() for c in (HEATING_FAILURE, SHOP))
    assert failing < heated - 3.0
    year = [halls(UNHEATED, clock).mean() for clock in (JANUARY, JULY)]
    assert year[1] - year[0] > 10.0
    level = [halls(SHOP, clock).mean() for clock in (JANUARY, JULY)]
    assert 1.0 < level[1] - level[0] < 4.0
    assert CONDITIONED.draughts_per_h == 0.0


@pytest.mark.parametrize("name", CLIMATES)
def test_every_climate_is_a_halls(name):
    climate = CLIMATES[name]
    for seed in range(20):
        rng = np.random.default_rng(seed)
        clock = Clock.draw(((0.0, WEEK_H),), climate.days, rng)
        there = surroundings(climate, clock, 2 * DAY, PERIOD_S, rng)
        assert np.isfinite(there).all()
        assert there.min() > -5.0
        assert there.max() < 42.0
        assert (there[:, 2] - there[:, 1]).mean() > 0.0  # warmer above


def test_winters_and_summers_begin_in_theirs():
    rng = np.random.default_rng(0)
    for climate, sign in ((WINTER, -1.0), (SUMMER, 1.0)):
        clocks = [Clock.draw(((0.0, WEEK_H),), climate.days, rng) for _ in range(50)]
        assert all(sign * season(clock, 1, PERIOD_S)[0] > 0.5 for clock in clocks)


def test_every_duty_cycle_has_a_climate_with_a_name():
    assert {cycle.climate for cycle in cycles.CYCLES.values()} <= set(CLIMATES.values())
    assert cycles.find("night").climate == SWINGING
    assert cycles.find("weekend").climate == cycles.find("shifts").climate == WEEKLY


def test_an_unknown_climate_gets_a_hint():
    with pytest.raises(InputError, match=r"^unknown climate 'unheted'; did you mean 'unheated'"):
        find("unheted")


def test_a_run_takes_the_climate_it_is_told():
    shop = open_shop("vmc3")
    own, winter = (
        simulate(shop, "r", "shop", (1, 2), 3.0, climate=climate) for climate in (None, replace(UNHEATED, days=(5, 6)))
    )
    assert winter.clock.day_of_year < 7.0
    assert own.sensors["ambient"].mean() > winter.sensors["ambient"].mean() + 3.0
    np.testing.assert_array_equal(own.channels["spindle_rpm"], winter.channels["spindle_rpm"])
