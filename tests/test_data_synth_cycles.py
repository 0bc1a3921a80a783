from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from data_synth import cycles, production
from data_synth.capability import Capability
from data_synth.clock import DAY_H, WEEK_H, YEAR_DAYS, Clock
from data_synth.iso_tests import SPEEDS
from data_synth.machines import DESIGNS
from data_synth.phases import Plan
from model.exceptions import InputError
from model.machine import load_machine, preset

THREE = Capability(
    12000.0, {"X": 15000.0, "Y": 15000.0, "Z": 12000.0}, {"X": (0.0, 800.0), "Y": (0.0, 500.0), "Z": (-200.0, 300.0)}
)
FIVE = Capability(
    18000.0,
    {**THREE.top_feed_per_min, "A": 6000.0, "C": 12000.0},
    {**THREE.strokes, "A": (-110.0, 110.0), "C": (0.0, 360.0)},
)
ON_THREE = tuple(name for name in cycles.NAMES if name != "rotary")
CASES = [*((name, THREE) for name in ON_THREE), *((name, FIVE) for name in cycles.NAMES)]
HOUR = 60


def made(kind, hours=24.0, seed=0, capability=FIVE, clock=cycles.MONDAY_MORNING):
    return cycles.make(kind, capability, hours, np.random.default_rng(seed), clock=clock)


def works(programme):
    return (programme.speed_rpm > 0.0) | (programme.feed_per_min > 0.0).any(axis=1)


def stretches(values):
    """Return (value, length) of each stretch of equal values."""
    edges = np.flatnonzero(np.diff(values)) + 1
    return [(piece[0], len(piece)) for piece in np.split(values, edges)]


@pytest.mark.parametrize(("kind", "capability"), CASES)
def test_a_duty_cycle_stays_within_what_the_machine_can(kind, capability):
    for seed in range(3):
        got = made(kind, 12.0, seed, capability)
        assert len(got) == 720
        assert got.axes == tuple(capability.strokes)
        assert got.feed_per_min.shape == got.stroke_low.shape == got.stroke_high.shape == (720, len(got.axes))
        assert (got.speed_rpm >= 0.0).all()
        assert (got.speed_rpm <= capability.top_rpm).all()
        top, low, high = capability.columns()
        assert (got.feed_per_min >= 0.0).all()
        assert (got.feed_per_min <= top).all()
        assert (got.stroke_low >= low - 1e-9).all()
        assert (got.stroke_high <= high + 1e-9).all()
        assert (got.stroke_high > got.stroke_low).all()
        assert (got.load >= 0.0).all()
        assert not got.starts[got.speed_rpm == 0.0].any()


@pytest.mark.parametrize("kind", cycles.NAMES)
def test_no_duty_cycle_is_empty_but_the_test_at_rest(kind):
    busy = [works(made(kind, 12.0, seed)).any() for seed in range(5)]
    assert not any(busy) if kind == "etve" else all(busy)


@pytest.mark.parametrize("kind", cycles.NAMES)
def test_a_longer_programme_begins_as_a_shorter_one(kind):
    long, short = (made(kind, hours) for hours in (12.0, 5.0))
    np.testing.assert_array_equal(long.part(slice(0, 300)).speed_rpm, short.speed_rpm)
    np.testing.assert_array_equal(long.part(slice(0, 300)).stroke_low, short.stroke_low)


@pytest.mark.parametrize("kind", ["shop", "spectrum", "doors"])
def test_a_phase_lasts_as_long_at_any_period(kind):
    means = []
    for period_s in (10.0, 60.0, 300.0):
        got = cycles.make(kind, THREE, 240.0, np.random.default_rng(1), period_s)
        means.append((got.speed_rpm.mean(), got.coolant.mean(), got.door.mean()))
    np.testing.assert_allclose(means, np.broadcast_to(means[0], (3, 3)), rtol=0.05, atol=0.005)


def test_the_environment_test_rests():
    assert not works(made("etve", 72.0)).any()


def test_the_spindle_test_turns_the_spindle_for_four_hours_and_stops_for_two():
    constants = spectra = 0
    for seed in range(8):
        got = made("spindle", 6.0, seed)
        assert not got.feed_per_min.any()
        assert not got.speed_rpm[4 * HOUR :].any()
        pieces = stretches(got.speed_rpm[: 4 * HOUR])
        constants += len(pieces) == 1
        spectra += len(pieces) > 1
        assert {length % 15 for _, length in pieces} == {0}
    assert constants
    assert spectra


def test_a_constant_speed_is_one_and_starts_once():
    got = made("constant")
    assert np.ptp(got.speed_rpm) == 0.0
    assert got.speed_rpm[0] > 0.0
    assert got.starts.sum() == 1.0


def test_steps_last_for_an_hour_to_three_and_a_spectrum_for_minutes():
    steps = [length for speed, length in stretches(made("steps", 200.0).speed_rpm) if speed > 0.0]
    assert min(steps[:-1]) >= HOUR
    assert max(steps) <= 3 * HOUR
    spectrum = made("spectrum", 200.0).speed_rpm
    assert set(np.unique(spectrum / FIVE.top_rpm)) == set(SPEEDS)
    assert np.median([length for speed, length in stretches(spectrum) if speed > 0.0]) < 20


@pytest.mark.parametrize(("kind", "which"), [("axes", "XYZ"), ("rotary", "AC")])
def test_a_test_of_axes_moves_one_at_a_time_between_two_points(kind, which):
    got = made(kind, 100.0)
    assert not got.speed_rpm.any()
    moving = got.feed_per_min > 0.0
    assert moving.sum(axis=1).max() == 1
    assert {axis for axis in got.axes if moving[:, got.column(axis)].any()} == set(which)
    assert 0.1 < (~moving.any(axis=1)).mean() < 0.6
    _, low, high = FIVE.columns()
    share = (got.stroke_high - got.stroke_low) / (high - low)
    assert share[moving].min() >= 0.5 - 1e-9
    both = np.column_stack([got.stroke_low, got.stroke_high])
    for axis in which:
        column = got.column(axis)
        ends = both[moving[:, column]][:, [column, len(got.axes) + column]]
        assert len(np.unique(ends, axis=0)) <= len(stretches(moving[:, column]))


def test_rotary_motion_needs_a_rotary_axis():
    with pytest.raises(InputError, match=r"^duty cycle 'rotary' must have a rotary axis to move, got X, Y, Z; leave"):
        made("rotary", capability=THREE)


def test_an_unknown_cycle_gets_a_hint():
    with pytest.raises(InputError, match=r"^unknown duty cycle 'weekends'; did you mean 'weekend'"):
        made("weekends")


def test_production_cuts_changes_tools_and_opens_the_door_between_parts():
    got = made("shop", 200.0)
    assert 0.6 < works(got).mean() < 0.95
    assert not works(got)[got.door].any()
    assert 0.02 < got.door.mean() < 0.3
    tools = got.starts.sum() / 200.0
    assert 4.0 < tools < 15.0  # per hour
    assert (got.load > 0.0).mean() > 0.5
    assert 0.2 < (got.feed_per_min[:, got.column("C")] > 0.0).mean() < 0.6


@pytest.mark.parametrize("kind", ["steps", "spectrum", "warmup", "spindle", "coolant", "shop"])
def test_a_spindle_starts_from_standstill_or_with_a_new_tool(kind):
    got = made(kind, 100.0)
    runs = got.speed_rpm > 0.0
    from_rest = runs & ~np.append(False, runs[:-1])
    assert (got.starts[from_rest] == 1.0).all()
    if kind == "shop":
        assert got.starts.sum() > 1.5 * from_rest.sum()
    elif kind != "warmup":  # jobs follow its warm-up
        assert got.starts.sum() == from_rest.sum()


def test_a_warm_up_rises():
    speeds = [speed for speed, _ in stretches(made("warmup", 1.0).speed_rpm) if speed > 0.0]
    assert len(speeds) >= 3
    assert speeds == sorted(speeds)


@pytest.mark.parametrize(("kind", "shortest"), [("restart", 30), ("breaks", 15)])
def test_restarts_and_breaks_stand_between_work(kind, shortest):
    pieces = stretches(works(made(kind, 100.0)))
    stood = [length for at_work, length in pieces if not at_work and length >= shortest - 1]
    assert len(stood) > 10
    assert 0.4 < works(made(kind, 100.0)).mean() < 0.9


def hour_of_week(clock, n):
    return clock.hours(n, 60.0) % WEEK_H


def test_shifts_work_on_workdays_from_six_with_breaks():
    seen = set()
    for seed in range(12):
        clock = Clock(5.0, 10.0)
        got = made("shifts", 2 * WEEK_H, seed, clock=clock)
        hour, busy = hour_of_week(clock, len(got)), works(got)
        last = max(hour[busy] % DAY_H)
        at_night = busy[(hour % DAY_H < 5.0) & (hour < 5 * DAY_H)].any()
        seen.add(3 if at_night else 2 if last > 14.5 else 1)
        assert not busy[(hour < 6.0) | (hour >= 5 * DAY_H + 6.0)].any()
        pause = (hour % DAY_H >= 9.01) & (hour % DAY_H < 9.24)
        assert not busy[pause].any()
    assert seen == {1, 2, 3}


def test_a_weekend_stands_from_friday_afternoon_to_monday_morning():
    clock = Clock(4 * DAY_H + 8.0, 40.0)
    got = made("weekend", WEEK_H, clock=clock)
    hour, busy = hour_of_week(clock, len(got)), works(got)
    off = (hour >= 4 * DAY_H + 14.0) | (hour < 6.0)
    assert not busy[off].any()
    assert busy[~off].mean() > 0.5
    for start in (0.0, 4.5):
        early = Clock(start, 40.0)
        first = np.flatnonzero(works(made("weekend", 12.0, clock=early)))[0]
        assert hour_of_week(early, first + 1)[-1] >= 6.0 - 1e-9


def test_coolant_goes_on_and_off_at_the_same_speed():
    got = made("coolant", 100.0)
    turns = np.flatnonzero(np.diff(got.coolant)) + 1
    same = [t for t in turns if got.speed_rpm[t] == got.speed_rpm[t - 1] > 0.0]
    assert len(same) > 20
    assert 0.2 < got.coolant.mean() < 0.8


def test_doors_stand_open_for_long():
    assert made("doors", 100.0).door.mean() > 2 * made("shop", 100.0).door.mean()
    assert max(length for is_open, length in stretches(made("doors", 100.0).door) if is_open) > 20


def test_nights_stand():
    busy = works(made("night", 200.0))
    assert 0.02 < busy.mean() < 0.25


def test_a_failing_heating_is_the_same_production():
    np.testing.assert_array_equal(made("heating").speed_rpm, made("shop").speed_rpm)


def test_data_sets_are_mostly_production_and_have_every_cycle():
    three, five = (cycles.order(load_machine(preset(name))) for name in ("vmc3", "trunnion5"))
    assert set(three) == set(ON_THREE)
    assert set(five) == set(cycles.NAMES)
    assert len(three) == len(five) == 24
    for order in (three, five):
        tests = ("etve", "spindle", "axes", "rotary", "constant", "steps", "spectrum", "night")
        assert sum(order.count(name) for name in tests) < len(order) / 2
        assert max(set(order), key=order.count) == order[0] == "shop"


def test_every_cycle_has_its_line_and_its_hours():
    lines = [cycles.describe(name) for name in cycles.NAMES]
    assert len(set(lines)) == len(lines)
    assert all(10 < len(line) <= 120 and "\n" not in line for line in lines)
    for cycle in cycles.CYCLES.values():
        clock = Clock.draw(cycle.hours, cycle.climate.days, np.random.default_rng(0))
        assert any(low <= clock.hour_of_week <= high for low, high in cycle.hours)


def test_hour_and_day_agree_and_pass_together():
    rng = np.random.default_rng(0)
    for _ in range(100):
        clock = Clock.draw(((0.0, WEEK_H),), (300.0, 430.0), rng)
        assert 0.0 <= clock.hour_of_week < WEEK_H
        assert clock.day_of_year >= 300.0 or clock.day_of_year < 66.0
        assert clock.day_of_year % 1.0 * DAY_H == pytest.approx(clock.hour_of_week % DAY_H)
        back = clock.later(30.0).later(-30.0)
        assert back.hour_of_week == pytest.approx(clock.hour_of_week)
        assert (back.day_of_year - clock.day_of_year + 1.0) % YEAR_DAYS == pytest.approx(1.0)


def test_a_job_that_meets_the_weekend_goes_on_after_it():
    plain = list(islice(production.shop(plan_at(0.0)), 8))
    pieces = production.weekend(plan_at(4 * DAY_H + 13.95))
    first = next(pieces)
    assert first.minutes == pytest.approx(3.0)
    assert next(pieces).minutes == pytest.approx(58 * 60.0)  # to the end of the week
    while not works_at(rest := next(pieces)):
        pass
    assert first.minutes + rest.minutes == pytest.approx(plain[0].minutes)
    assert replace(rest, minutes=0.0) == replace(plain[0], minutes=0.0)
    assert next(pieces) == plain[1]


def plan_at(hour):
    return Plan(("X",), (), Clock(hour, 0.0), np.random.default_rng(3))


def works_at(phase):
    return phase.speed > 0.0 or phase.door


@pytest.mark.parametrize("name", DESIGNS)
def test_a_designs_capability_fits_its_machine(name):
    machine, capability = load_machine(preset(name)), DESIGNS[name].capability
    assert capability.axes == machine.axis_names == tuple(capability.top_feed_per_min)
    for axis, (low, high) in capability.strokes.items():
        assert machine.axes[axis].low <= low < high <= machine.axes[axis].high
    assert min(capability.top_feed_per_min.values()) > 0.0
    assert set(cycles.order(machine)) <= set(cycles.NAMES)
