"""Which readings the guard believes, and when it believes them again."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from model.machine import Sensor
from model.sensors import SensorModel
from service.agreement import FREEDOM, Agreement
from service.first_reading import doubtful
from service.guard import AGAINST, AGREE_K, CARRY_S, CONFIRM_S, NOISE_K, STUCK_K, STUCK_S, Judgement, Track, judge

SENSORS = {
    "spindle": Sensor(range_degC=(-10.0, 100.0), max_rate_degC_per_min=20.0),
    "bed": Sensor(range_degC=(0.0, 60.0), max_rate_degC_per_min=6.0),
}
MODEL = SensorModel(np.array([30.0, 22.0]), np.array([[60.0, 8.0], [8.0, 4.0]]))
LOOSE = Agreement(MODEL)
QUICK = settings(max_examples=12, deadline=None)

NAMES = ("a", "b", "c", "d", "e")
ALIKE = {name: Sensor(range_degC=(-10.0, 100.0), max_rate_degC_per_min=6.0) for name in NAMES}
TOGETHER = Agreement(SensorModel(np.full(5, 22.0), 9.0 * np.ones((5, 5)) + 0.2 * np.eye(5)))
"""Five sensors that rise and fall together, and half a kelvin apart."""


def after(tracks: dict[str, Track], time_s: float, spindle: float | None, bed: float | None = 20.0) -> Judgement:
    return judge(SENSORS, tracks, time_s, {"spindle": spindle, "bed": bed}, LOOSE)


def follow(readings: np.ndarray, every_s: float = 60.0, tracks: dict[str, Track] | None = None) -> list[Judgement]:
    """Judge rows of the five sensors' readings, NaN where there is none."""
    verdicts = []
    tracks = tracks or {}
    for step, row in enumerate(readings):
        given = {n: None if math.isnan(v) else float(v) for n, v in zip(NAMES, row, strict=True)}
        verdicts.append(judge(ALIKE, tracks, every_s * step, given, TOGETHER))
        tracks = verdicts[-1].tracks
    return verdicts


def faulty(verdicts: list[Judgement]) -> list[set[str]]:
    return [set(v.faults) for v in verdicts]


def shop(steps: int, seed: int = 0, step_K: float = 0.1) -> np.ndarray:
    """Readings of a machine that warms up and cools down by some kelvin, with noise and tenths."""
    rng = np.random.default_rng(seed)
    common = 22.0 + 4.0 * np.sin(np.arange(steps) / 40.0)
    readings = common[:, None] + rng.normal(0.0, 0.3, 5) + rng.normal(0.0, 0.05, (steps, 5))
    return np.round(readings / step_K) * step_K


def test_plausible_readings_pass_unchanged() -> None:
    verdict = after({}, 0.0, 25.0)
    np.testing.assert_array_equal(verdict.readings, [25.0, 20.0])
    assert verdict.faults == {}
    np.testing.assert_array_equal(after(verdict.tracks, 60.0, 30.0).readings, [30.0, 20.0])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("step_K", [0.1, 0.5, 1.0])
def test_a_healthy_machine_is_left_alone(seed: int, step_K: float) -> None:
    assert not any(faulty(follow(shop(500, seed, step_K))))


@pytest.mark.parametrize("reading", [None, math.nan, math.inf, -math.inf, 101.0, -10.1])
def test_missing_and_impossible_readings_are_replaced_and_leave_the_track_alone(reading: float | None) -> None:
    first = after({}, 0.0, 25.0)
    verdict = after(first.tracks, 60.0, reading)
    np.testing.assert_array_equal(verdict.readings, [math.nan, 20.0])
    assert list(verdict.faults) == ["spindle"]
    assert verdict.tracks["spindle"] == first.tracks["spindle"]


def test_a_sensor_left_out_is_missing() -> None:
    assert judge(SENSORS, {}, 0.0, {"bed": 20.0}, LOOSE).faults == {"spindle": "has no reading"}


def test_a_machine_without_sensors_has_no_faults() -> None:
    nothing = Agreement(SensorModel(np.empty(0), np.empty((0, 0))))
    assert judge({}, {}, 0.0, {}, nothing).faults == {}


def test_a_lone_sensor_is_judged_by_its_rate_alone() -> None:
    alone = {"bed": SENSORS["bed"]}
    agreement = Agreement(SensorModel(np.array([22.0]), np.array([[4.0]])))
    tracks = judge(alone, {}, 0.0, {"bed": 40.0}, agreement).tracks
    jump_K = 15.0  # it may change 6 K/min
    allowed_from_s = (jump_K - NOISE_K) / 6.0 * 60.0
    for time_s in (1.0, 60.0, allowed_from_s - 1.0):
        verdict = judge(alone, tracks, time_s, {"bed": 40.0 + jump_K}, agreement)
        assert verdict.faults["bed"].startswith("jumped by +15.0 K in ")
        assert math.isnan(verdict.readings[0])
    assert judge(alone, tracks, allowed_from_s + 1.0, {"bed": 40.0 + jump_K}, agreement).faults == {}


def test_a_jump_with_all_sensors_is_believed_after_a_while() -> None:
    readings = np.vstack([np.full((5, 5), 20.0), np.full((20, 5), 45.0)])
    verdicts = follow(readings)
    assert faulty(verdicts)[5] == set(NAMES)
    back = next(i for i, names in enumerate(faulty(verdicts)) if i > 5 and not names)
    assert 60.0 * (back - 5) <= CONFIRM_S + 60.0
    assert not any(faulty(verdicts)[back:])


@QUICK
@given(st.integers(0, 4), st.sampled_from([-5.0, -4.0, 4.0, 5.0, 20.0]), st.integers(0, 9))
def test_a_sensor_that_jumps_and_stays_is_not_believed_until_it_agrees_again(wrong: int, by: float, seed: int) -> None:
    readings = shop(120, seed)
    readings[40:100, wrong] += by
    verdicts = faulty(follow(readings))
    assert all(found == {NAMES[wrong]} for found in verdicts[40:100])
    assert not any(verdicts[:40])
    assert not any(verdicts[100 + round(CONFIRM_S / 60.0) + 1 :])


@QUICK
@given(st.integers(0, 4), st.sampled_from([-40.0, -5.0, 5.0, 60.0]))
def test_a_spike_is_one_sample_long(wrong: int, by: float) -> None:
    readings = shop(60)
    readings[30, wrong] += by
    verdicts = faulty(follow(readings))
    assert verdicts[30] == {NAMES[wrong]}
    assert not any(verdicts[:30] + verdicts[31:])


def test_two_sensors_exchanged_are_both_found() -> None:
    """One is 12 K warmer than the others, as it is in training."""
    names = "abcdefgh"
    mean = np.array([34.0, *[22.0] * 7])
    agreement = Agreement(SensorModel(mean, 9.0 * np.ones((8, 8)) + 0.2 * np.eye(8)))
    sensors = dict.fromkeys(names, ALIKE["a"])
    tracks: dict[str, Track] = {}
    for step, row in enumerate(np.hstack([shop(60), shop(60)[:, :3]]) + (mean - 22.0)):
        shown = row.copy()
        if step >= 30:
            shown[[0, 3]] = shown[[3, 0]]
        verdict = judge(sensors, tracks, 60.0 * step, dict(zip(names, shown.tolist(), strict=True)), agreement)
        tracks = verdict.tracks
        assert set(verdict.faults) == ({"a", "d"} if step >= 30 else set())


def test_sensors_exchanged_from_the_start_are_found_once_they_part() -> None:
    """Two that are alike while the machine is cold, of which one then warms up by 12 K."""
    names = "abcdefgh"
    rng = np.random.default_rng(0)
    warm = 12.0 * (1.0 - np.exp(-np.arange(240) / 60.0))
    readings = 22.0 + rng.normal(0.0, 0.1, (240, 8)) + np.outer(warm / 12.0, [12.0, 3.0, 3.0, 0.5, 4.0, 5.0, 6.0, 2.0])
    spread = np.array([6.0, 1.5, 1.5, 0.4, 2.0, 2.5, 3.0, 1.0])
    agreement = Agreement(SensorModel(np.full(8, 22.0), 4.0 + np.outer(spread, spread) + 0.1 * np.eye(8)))
    for exchange in (False, True):
        shown = readings.copy()
        if exchange:
            shown[:, [0, 3]] = shown[:, [3, 0]]
        tracks: dict[str, Track] = {}
        found = []
        for step, row in enumerate(shown):
            verdict = judge(
                dict.fromkeys(names, ALIKE["a"]), tracks, 60.0 * step, dict(zip(names, row, strict=True)), agreement
            )
            tracks = verdict.tracks
            found.append(set(verdict.faults))
        assert found[-1] == ({"a", "d"} if exchange else set())
        assert set().union(*found) == found[-1]


def test_where_most_sensors_are_unlike_training_time_alone_decides() -> None:
    """A hall hotter than any, and each sensor for itself: they cannot all be wrong."""
    readings = np.vstack([np.full((5, 5), 22.0), np.tile([45.0, 50.0, 40.0, 55.0, 35.0], (20, 1))])
    verdicts = faulty(follow(readings))
    assert verdicts[5] == set(NAMES)
    assert not any(verdicts[5 + round(CONFIRM_S / 60.0) + 1 :])


def test_what_drifts_slowly_is_found_once_no_season_explains_it() -> None:
    readings = shop(600)
    readings[:, 2] += np.linspace(0.0, 12.0, 600)
    verdicts = follow(readings)
    first = next(i for i, v in enumerate(verdicts) if v.faults)
    assert 4.0 < np.linspace(0.0, 12.0, 600)[first] < 8.0
    assert all(set(v.faults) == {"c"} for v in verdicts[first:])
    assert verdicts[first].faults["c"].startswith("reads ")
    assert "where the other sensors suggest" in verdicts[first].faults["c"]


@QUICK
@given(st.integers(0, 4), st.integers(0, 9))
def test_a_stuck_sensor_is_found_once_the_others_have_moved(stuck: int, seed: int) -> None:
    readings = shop(200, seed)
    readings[20:120, stuck] = readings[19, stuck]
    verdicts = follow(readings)
    found = [i for i, v in enumerate(verdicts) if NAMES[stuck] in v.faults]
    assert found[0] * 60.0 >= 20 * 60.0 + STUCK_S
    moved_K = abs(readings[found[0], stuck] - np.delete(readings[found[0]], stuck).mean())
    assert moved_K < 2.0 * STUCK_K + 0.6
    assert found == list(range(found[0], found[-1] + 1))
    assert found[-1] <= 120 + round(CONFIRM_S / 60.0)
    assert all(set(v.faults) <= {NAMES[stuck]} for v in verdicts)
    assert "has shown" in verdicts[found[0]].faults[NAMES[stuck]]


@QUICK
@given(st.integers(0, 4))
def test_a_coarse_sensor_in_a_calm_shop_is_not_stuck(still: int) -> None:
    """It stands still for ten hours while the others rise and fall by less than it can show."""
    rng = np.random.default_rng(still)
    readings = 22.0 + 0.4 * np.sin(np.arange(600) / 60.0)[:, None] + rng.normal(0.0, 0.05, (600, 5))
    readings[:, still] = 22.0
    assert not any(faulty(follow(readings)))


@QUICK
@given(st.integers(0, 4), st.sampled_from([math.nan, 150.0, 60.0]), st.integers(0, 9))
def test_a_reading_lost_for_a_short_while_is_carried_on(lost: int, shows: float, seed: int) -> None:
    """As far apart from the others as it was, and not where it usually is: nothing jumps."""
    readings = shop(60, seed)
    readings[:, lost] += 1.0
    whole = readings.copy()
    readings[30:, lost] = shows
    for step, verdict in enumerate(follow(readings)):
        if step < 30:
            np.testing.assert_array_equal(verdict.carried, verdict.readings)
        elif 60.0 * (step - 29) <= CARRY_S:
            assert verdict.carried[lost] == pytest.approx(whole[step, lost], abs=0.5)
        else:
            assert math.isnan(verdict.carried[lost])


def test_with_all_sensors_lost_they_stay_for_a_while() -> None:
    readings = shop(30)
    readings[20:] = math.nan
    verdicts = follow(readings)
    np.testing.assert_allclose(verdicts[25].carried, readings[19])


def test_a_stuck_sensor_is_not_carried_on_from_where_it_stuck() -> None:
    readings = shop(120)
    readings[20:, 2] = readings[19, 2]
    for verdict in follow(readings)[60:]:
        assert "c" not in verdict.faults or math.isnan(verdict.carried[2])


def test_noise_is_no_jump_however_fast_samples_come() -> None:
    tracks = after({}, 0.0, 25.0).tracks
    for step in range(1, 50):
        verdict = after(tracks, 0.01 * step, 25.0 + 0.4 * (-1) ** step)
        assert verdict.faults == {}
        tracks = verdict.tracks


def test_a_change_against_the_others_is_allowed_up_to_its_share_of_the_rate() -> None:
    """The other four stand still, so they suggest none."""
    for factor, found in ((0.9, set()), (1.1, {"b"})):
        readings = np.full((2, 5), 22.0)
        readings[1, 1] += factor * (NOISE_K + AGAINST * 6.0)
        assert faulty(follow(readings))[1] == found


@QUICK
@given(st.lists(st.lists(st.none() | st.floats(), min_size=5, max_size=5), max_size=12), st.floats(0.0, 1e4))
def test_what_passes_is_always_within_range_and_all_else_has_a_reason(
    rows: list[list[float | None]], every_s: float
) -> None:
    tracks: dict[str, Track] = {}
    for step, row in enumerate(rows):
        verdict = judge(ALIKE, tracks, every_s * step, dict(zip(NAMES, row, strict=True)), TOGETHER)
        tracks = verdict.tracks
        for name, reading, given_degC in zip(NAMES, verdict.readings, row, strict=True):
            assert np.isnan(reading) == (name in verdict.faults)
            if name not in verdict.faults:
                assert reading == given_degC
                assert -10.0 <= reading <= 100.0
                assert tracks[name].good_degC == reading


@QUICK
@given(st.lists(st.lists(st.floats(-10.0, 100.0), min_size=5, max_size=5), max_size=6), st.integers(0, 9))
def test_whatever_came_before_a_healthy_machine_is_believed_again(rows: list[list[float]], seed: int) -> None:
    """Unless it is the track of one sensor against the rest, any past is forgotten within the time to confirm."""
    before = follow(np.array(rows).reshape(-1, 5))
    tracks = before[-1].tracks if before else {}
    start_s = 60.0 * len(rows)
    for step, row in enumerate(shop(40, seed)):
        verdict = judge(ALIKE, tracks, start_s + 60.0 * step, dict(zip(NAMES, row.tolist(), strict=True)), TOGETHER)
        tracks = verdict.tracks
    assert verdict.faults == {}


@pytest.mark.parametrize("spread_K", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("strangest", [1.5, math.inf])
def test_agreement_is_the_conditional_distribution(spread_K: float, strangest: float) -> None:
    """By an independent way: the conditional mean and variance of one given the others, wider on a strange day."""
    rng = np.random.default_rng(3)
    half = rng.normal(size=(6, 6))
    model = SensorModel(rng.normal(25.0, 3.0, 6), half @ half.T)
    readings = rng.normal(25.0, spread_K, 6)
    readings[4] = math.nan
    distance, usual = Agreement(model).distances(readings, strangest)
    total = model.covariance + 0.01 * np.eye(6)
    for i in (0, 1, 2, 3, 5):
        without = readings.copy()
        without[i] = math.nan
        assert distance[i] == pytest.approx(readings[i] - model.fill(without)[i])
        others = [k for k in (0, 1, 2, 3, 5) if k != i]
        gain = np.linalg.solve(total[np.ix_(others, others)], total[others, i])
        centred = (readings - model.mean)[others]
        squared = centred @ np.linalg.solve(total[np.ix_(others, others)], centred)
        strange = np.sqrt(np.clip((FREEDOM + squared) / (FREEDOM + len(others)), 1.0, strangest**2))
        assert usual[i] == pytest.approx(strange * np.sqrt(total[i, i] - gain @ total[others, i]))
    assert distance[4] == 0.0
    assert usual[4] == math.inf


TIGHT = SensorModel(np.array([25.0, 22.0, 21.0]), np.array([[9.0, 4.0, 2.0], [4.0, 4.0, 2.0], [2.0, 2.0, 2.0]]))


def test_first_readings_that_agree_are_believed() -> None:
    assert doubtful(TIGHT, np.array([28.0, 23.0, 22.0]), np.full(3, True)) == {}


@QUICK
@given(st.integers(0, 2), st.sampled_from([-30.0, -18.0, 18.0, 40.0]))
def test_one_wrong_first_reading_is_found_and_its_neighbours_are_not_blamed(wrong: int, by: float) -> None:
    readings = np.array([25.0, 22.0, 21.0])
    readings[wrong] += by
    found = doubtful(TIGHT, readings, np.full(3, True))
    assert list(found) == [wrong]
    assert found[wrong] == pytest.approx([25.0, 22.0, 21.0][wrong], abs=1.0)


def test_two_wrong_first_readings_are_both_found() -> None:
    model = SensorModel(np.full(6, 22.0), 4.0 * np.ones((6, 6)) + 0.1 * np.eye(6))
    assert set(doubtful(model, np.array([22.0, 60.0, 22.1, 51.0, 21.9, 22.0]), np.full(6, True))) == {1, 3}


def test_readings_of_sensors_with_a_past_and_lone_ones_are_not_doubted_here() -> None:
    readings = np.array([90.0, 22.0, 21.0])
    assert doubtful(TIGHT, readings, np.array([False, True, True])).get(0) is None
    assert doubtful(TIGHT, np.array([90.0, np.nan, np.nan]), np.full(3, True)) == {}


def test_a_doubted_first_reading_is_believed_once_it_agrees() -> None:
    sensors = {name: Sensor(range_degC=(-10.0, 100.0)) for name in "abc"}
    tracks: dict[str, Track] = {}
    believed = []
    agreement = Agreement(TIGHT)
    for step in range(30):
        a = 60.0 if step < 20 else 24.0 + AGREE_K
        verdict = judge(sensors, tracks, 30.0 * step, {"a": a, "b": 22.0, "c": 21.0}, agreement)
        tracks = verdict.tracks
        believed.append("a" not in verdict.faults)
        if not believed[-1]:
            assert verdict.faults["a"].startswith("reads 60 °C, where the other sensors suggest")
    assert believed == [step >= 20 for step in range(30)]
