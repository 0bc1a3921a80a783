import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from model.machine import Sensor
from model.sensors import SensorModel
from service.first_reading import doubtful
from service.guard import CONFIRM_S, NOISE_K, Judgement, Track, judge

SENSORS = {
    "spindle": Sensor(range_degC=(-10.0, 100.0), max_rate_degC_per_min=20.0),
    "bed": Sensor(range_degC=(0.0, 60.0), max_rate_degC_per_min=6.0),
}

MODEL = SensorModel(np.array([30.0, 22.0]), np.array([[60.0, 8.0], [8.0, 4.0]]))


def after(tracks: dict[str, Track], time_s: float, spindle: float | None, bed: float | None = 20.0) -> Judgement:
    return judge(SENSORS, tracks, time_s, {"spindle": spindle, "bed": bed}, MODEL)


def test_plausible_readings_pass_unchanged() -> None:
    verdict = after({}, 0.0, 25.0)
    np.testing.assert_array_equal(verdict.readings, [25.0, 20.0])
    assert verdict.faults == {}
    np.testing.assert_array_equal(after(verdict.tracks, 60.0, 44.0).readings, [44.0, 20.0])


@pytest.mark.parametrize("reading", [None, math.nan, math.inf, -math.inf, 101.0, -10.1])
def test_missing_and_impossible_readings_are_replaced_and_leave_the_track_alone(reading: float | None) -> None:
    first = after({}, 0.0, 25.0)
    verdict = after(first.tracks, 60.0, reading)
    np.testing.assert_array_equal(verdict.readings, [math.nan, 20.0])
    assert list(verdict.faults) == ["spindle"]
    assert verdict.tracks["spindle"] == first.tracks["spindle"]


def test_a_sensor_left_out_is_missing() -> None:
    assert judge(SENSORS, {}, 0.0, {"bed": 20.0}, MODEL).faults == {"spindle": "has no reading"}


def test_a_jump_is_replaced_until_the_time_since_the_last_good_reading_allows_it() -> None:
    tracks = after({}, 0.0, 20.0, 20.0).tracks
    jump_K = 15.0  # the bed may change 6 K/min
    allowed_from_s = (jump_K - NOISE_K) / 6.0 * 60.0
    for time_s in (1.0, 60.0, allowed_from_s - 1.0):
        verdict = after(tracks, time_s, 20.0, 20.0 + jump_K)
        assert verdict.faults["bed"].startswith("jumped by +15.0 K in ")
        assert math.isnan(verdict.readings[1])
    assert after(tracks, allowed_from_s + 1.0, 20.0, 20.0 + jump_K).faults == {}


def test_a_reading_that_stays_at_its_new_level_is_believed_after_a_while() -> None:
    tracks = after({}, 0.0, 20.0, 5.0).tracks
    believed = []
    for time_s in np.arange(10.0, CONFIRM_S + 30.0, 10.0):
        verdict = after(tracks, float(time_s), 20.0, 55.0)  # 50 K at 6 K/min would take eight minutes
        tracks = verdict.tracks
        believed.append(not verdict.faults)
    first = believed.index(True)
    assert 10.0 + first * 10.0 == pytest.approx(CONFIRM_S + 10.0)
    assert all(believed[first:])


def test_a_reading_that_jumps_about_is_never_believed() -> None:
    tracks = after({}, 0.0, 20.0, 30.0).tracks
    for step in range(1, 200):
        verdict = after(tracks, 2.0 * step, 20.0, 58.0 if step % 2 else 2.0)
        # By then the time since the last good reading allows any change within the range.
        if 2.0 * step < (28.0 - NOISE_K) / 6.0 * 60.0:
            assert "bed" in verdict.faults
        tracks = verdict.tracks


def test_noise_is_no_jump_however_fast_samples_come() -> None:
    tracks = after({}, 0.0, 25.0).tracks
    for step in range(1, 50):
        verdict = after(tracks, 0.01 * step, 25.0 + 0.4 * (-1) ** step)
        assert verdict.faults == {}
        tracks = verdict.tracks


@given(st.lists(st.tuples(st.floats(0.0, 1e4), st.none() | st.floats()), max_size=20))
def test_what_passes_is_always_within_range_and_all_else_has_a_reason(
    readings: list[tuple[float, float | None]],
) -> None:
    tracks: dict[str, Track] = {}
    for time_s, reading in sorted(readings, key=lambda r: r[0]):
        verdict = after(tracks, time_s, reading)
        tracks = verdict.tracks
        assert np.isnan(verdict.readings[0]) == ("spindle" in verdict.faults)
        if "spindle" not in verdict.faults:
            assert -10.0 <= verdict.readings[0] <= 100.0


TIGHT = SensorModel(np.array([25.0, 22.0, 21.0]), np.array([[9.0, 4.0, 2.0], [4.0, 4.0, 2.0], [2.0, 2.0, 2.0]]))


def test_first_readings_that_agree_are_believed() -> None:
    assert doubtful(TIGHT, np.array([28.0, 23.0, 22.0]), np.full(3, True)) == {}


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


def test_a_doubted_first_reading_that_stays_is_believed_after_a_while() -> None:
    sensors = {name: Sensor(range_degC=(-10.0, 100.0)) for name in "abc"}
    tracks: dict[str, Track] = {}
    believed = []
    for t in np.arange(0.0, CONFIRM_S + 60.0, 30.0):
        verdict = judge(sensors, tracks, float(t), {"a": 60.0, "b": 22.0, "c": 21.0}, TIGHT)
        tracks = verdict.tracks
        believed.append("a" not in verdict.faults)
        if not believed[-1]:
            assert verdict.faults["a"].startswith("reads 60 °C, where the other sensors suggest")
    assert believed[0] is False
    assert believed[-1] is True
