"""The laws of what is served: within its limits, no faster than its rate, never NaN, and there in the end."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from machines import ARRANGEMENTS, machine_text
from service_client import TINY

from model.bundle import load_bundle
from model.chain import Chain
from model.compensation import compensate
from model.error_map import ErrorMap
from model.machine import Limits, Machine, parse_machine
from service.reach import Reach, turn_rad
from service.safety import MAX_REACH, Served, Target, advance, bounded, clip, is_usable

LIMITS = Limits(max_correction_um=300.0, max_rate_um_per_min=60.0)
MACHINE = load_bundle(TINY).machine
CHAIN = Chain(MACHINE)
REACH = Reach.of(CHAIN)
RNG = np.random.default_rng(1)
PLACES = np.vstack(
    [
        RNG.uniform([0.0, 0.0, 0.0], [800.0, 500.0, 500.0], (6, 3)),
        [[0.0, 0.0, 0.0], [800.0, 500.0, 500.0], [800.0, 0.0, 500.0]],
    ]
)


def random_map(seed: int, size: float, machine: Machine = MACHINE, knots: int = 5) -> ErrorMap:
    """Every term random and rough, of up to `size` µm or µrad."""
    rng = np.random.default_rng(seed)
    rows: list[tuple[str, float | None, float]] = []
    for term in machine.terms:
        if term.kind == "location":
            rows.append((term.name, None, size * rng.uniform(-1, 1)))
            continue
        axis = machine.axes[term.axis]
        rows += [(term.name, float(p), size * rng.uniform(-1, 1)) for p in np.linspace(axis.low, axis.high, knots)]
    return ErrorMap.from_rows(machine, rows)


def corrections(errors: ErrorMap, tool_mm: Any = None) -> np.ndarray[Any, np.dtype[np.float64]]:
    """What the real compensation commands at fixed places, clipped as served [µm]."""
    found = compensate(CHAIN, PLACES, errors, tool_mm)
    return clip(found.corrected - PLACES, LIMITS)[0] * 1e3


def target(errors: ErrorMap) -> Target:
    return Target(errors, None, 0.0)


STEPS = st.lists(
    st.tuples(
        st.integers(0, 10**6),  # which thermal map
        st.sampled_from([0.0, 0.1, 10.0, 300.0, 3e4, 1e6, 1e9]),  # of which size
        st.floats(-0.5, 1.5) | st.just(math.nan),  # its weight
        st.sampled_from([-100.0, 0.0, 0.01, 1.0, 20.0, 300.0]),  # by how much the time moves
    ),
    min_size=1,
    max_size=8,
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(STEPS)
def test_whatever_is_wanted_the_correction_stays_in_its_limits_and_below_its_rate(steps: list[Any]) -> None:
    geometric = random_map(0, 10.0)
    served: Served | None = None
    before: np.ndarray[Any, np.dtype[np.float64]] | None = None
    now_s = 0.0
    for seed, size, weight, dt_s in steps:
        now_s += dt_s
        wanted = Target(geometric, random_map(seed, size), weight)
        moved = advance(served, wanted, now_s, LIMITS, REACH)
        found = corrections(moved.errors)
        assert np.isfinite(found).all()
        assert np.abs(found).max() <= LIMITS.max_correction_um * (1 + 1e-12)
        if served is not None and before is not None:
            assert moved.time_s >= served.time_s
            allowed_um = LIMITS.max_rate_um_per_min * (moved.time_s - served.time_s) / 60.0
            assert np.abs(found - before).max() <= allowed_um + 2e-3  # compensation itself is exact to 1 nm
        served, before = moved, found


@pytest.mark.parametrize("seed", range(5))
def test_the_rate_holds_for_every_tool_that_was_seen(seed: int) -> None:
    rng = np.random.default_rng(seed)
    reach = REACH.including(50.0).including(400.0)
    served = advance(None, target(random_map(seed, 20.0)), 0.0, LIMITS, reach)
    moved = advance(served, target(random_map(seed + 100, 20.0)), 20.0, LIMITS, reach)
    assert not moved.arrived
    for length in (50.0, 400.0, rng.uniform(50.0, 400.0)):
        tool_mm = np.array([0.0, 0.0, -length])
        change = corrections(moved.errors, tool_mm) - corrections(served.errors, tool_mm)
        assert 0.0 < np.abs(change).max() <= 20.0


def test_it_gets_there_and_says_how_far_it_is() -> None:
    start, goal = ErrorMap.zero(MACHINE), random_map(3, 10.0)
    served = advance(None, target(start), 0.0, LIMITS, REACH)
    assert served.arrived
    remaining = [math.inf]
    while not served.arrived:
        served = advance(served, target(goal), served.time_s + 1.0, LIMITS, REACH)
        distance = np.abs(corrections(served.errors) - corrections(goal)).max()
        assert distance <= served.remaining_um * 1.02 + 2e-3
        assert served.remaining_um < remaining[-1]
        remaining.append(served.remaining_um)
    served = advance(served, target(goal), served.time_s, LIMITS, REACH)
    while not served.arrived:
        served = advance(served, target(goal), served.time_s + 1.0, LIMITS, REACH)
        assert served.remaining_um < remaining[-1]
        remaining.append(served.remaining_um)
    assert served.errors is goal
    # One second moves the bound by one micrometre, less the margin for what the bound leaves out.
    assert -np.diff(remaining[1:-1]) == pytest.approx(0.98, rel=0.1)


def test_the_bound_is_reached_by_one_term_alone() -> None:
    """EXX moves X alone, at one for one: nothing but the margin is lost."""
    goal = ErrorMap.from_rows(MACHINE, [("EXX", 0.0, 50.0)])
    served = advance(None, target(ErrorMap.zero(MACHINE)), 0.0, LIMITS, REACH)
    moved = advance(served, target(goal), 30.0, LIMITS, REACH)
    assert np.abs(corrections(moved.errors)).max() == pytest.approx(30.0 * 0.98)
    assert moved.remaining_um == pytest.approx(50.0 - 30.0 * 0.98)


@pytest.mark.parametrize("slope", [-0.09, 0.09])
def test_the_rate_holds_where_terms_are_steep(slope: float) -> None:
    """A steep term answers a change with more than the change, since it is read at the corrected position."""
    knots, ramp = (380.0, 397.0, 403.0, 420.0), (-3000.0 * slope, 3000.0 * slope)
    steep = ErrorMap.from_rows(MACHINE, [("EXX", p, v) for p, v in zip(knots, (0.0, *ramp, 0.0), strict=True)])
    shifted = steep + ErrorMap.from_rows(MACHINE, [("EXX", 0.0, 100.0)])
    served = advance(None, target(steep), 0.0, LIMITS, REACH)
    moved = advance(served, target(shifted), 60.0, LIMITS, REACH)
    q = np.array([[400.0, 0.0, 0.0]])
    change_mm = compensate(CHAIN, q, moved.errors).corrected - compensate(CHAIN, q, served.errors).corrected
    assert 0.04 < np.abs(change_mm).max() <= 0.06


def test_the_first_target_is_adopted_at_once() -> None:
    goal = random_map(4, 10.0)
    served = advance(None, target(goal), 5.0, LIMITS, REACH)
    assert served.errors is goal
    assert served.arrived


def test_time_that_goes_back_moves_nothing() -> None:
    served = advance(None, target(random_map(5, 10.0)), 100.0, LIMITS, REACH)
    moved = advance(served, target(random_map(6, 10.0)), 40.0, LIMITS, REACH)
    assert moved.time_s == 100.0
    np.testing.assert_allclose(corrections(moved.errors), corrections(served.errors), atol=2e-3)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300])
def test_a_target_that_is_not_usable_leaves_what_was_served(bad: float) -> None:
    zero = ErrorMap.zero(MACHINE)
    broken = ErrorMap(MACHINE, zero.knots, zero.motion, np.full_like(zero.location, bad))
    assert not is_usable(broken)
    geometric = random_map(7, 5.0)
    first = advance(None, Target(geometric, broken, 1.0), 0.0, LIMITS, REACH)
    assert first.errors is geometric
    assert first.held
    good = advance(None, target(random_map(8, 5.0)), 0.0, LIMITS, REACH)
    held = advance(good, Target(geometric, broken, 1.0), 60.0, LIMITS, REACH)
    assert held.errors is good.errors
    assert (held.held, held.arrived, held.time_s) == (True, False, 60.0)


def test_a_wild_target_does_not_take_long_to_come_back_from() -> None:
    wild = bounded(random_map(9, 1e5), LIMITS, REACH)
    assert REACH.correction_mm(wild) <= MAX_REACH * LIMITS.max_correction_um * 1e-3 * (1 + 1e-9)
    sound = random_map(10, 20.0)
    assert bounded(sound, LIMITS, REACH) is sound
    served = advance(None, target(random_map(9, 1e5)), 0.0, LIMITS, REACH)
    assert not served.arrived


@pytest.mark.parametrize("structure", ARRANGEMENTS)
def test_the_reach_bounds_the_first_order_correction_everywhere(structure: str) -> None:
    machine = parse_machine(machine_text(structure))
    chain = Chain(machine)
    reach = Reach.of(chain).including(80.0).including(300.0)
    rng = np.random.default_rng(2)
    low, high = ([getattr(machine.axes[a], end) for a in machine.axis_names] for end in ("low", "high"))
    q = rng.uniform(low, high, (40, 3))
    for length in (80.0, 300.0, rng.uniform(80.0, 300.0), None):
        tool_mm = None if length is None else length * np.asarray(machine.tool.direction)
        gain = np.linalg.solve(chain.jacobian(q, tool_mm)[:, :3], chain.sensitivity(q, tool_mm)[:, :3])
        assert (np.abs(gain) <= reach.gain * (1 + 1e-12) + 1e-12).all()


def test_a_tool_between_two_seen_before_changes_nothing() -> None:
    reach = REACH.including(50.0).including(200.0)
    assert reach.including(100.0) is reach
    assert reach.including(None) is reach


def test_clipping_names_the_points_it_touched() -> None:
    clipped, touched = clip(np.array([[0.1, 0.0, 0.0], [0.0, -0.5, 0.3]]), LIMITS)
    np.testing.assert_allclose(clipped, [[0.1, 0.0, 0.0], [0.0, -0.3, 0.3]])
    assert touched.tolist() == [False, True]


def test_the_turn_of_a_map_is_the_sum_of_its_angles() -> None:
    errors = ErrorMap.from_rows(MACHINE, [("EAX", 0.0, 10.0), ("EAX", 800.0, -30.0), ("EC0Y", None, 5.0)])
    assert turn_rad(errors) == pytest.approx(35e-6)
