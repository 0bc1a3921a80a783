from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from data_synth import cycles
from data_synth.capability import Capability
from data_synth.climates import SHOP
from data_synth.clock import MONDAY_MORNING
from data_synth.environment import surroundings
from data_synth.heat import AccelerationSource, FeedSource, PowerLaw, SpindleStartSource
from data_synth.machines import DESIGNS, open_shop
from data_synth.network import REST, OperatingPoint
from data_synth.run import check_periods, simulate
from model.exceptions import InputError

VMC3 = open_shop("vmc3")
CAN = Capability(10000.0, {"X": 20000.0, "C": 12000.0}, {"X": (0.0, 800.0), "C": (-180.0, 180.0)})
MOTOR = AccelerationSource("X", {"motor": 0.9, "bed": 0.1}, 2000.0, 5.0, 500.0, 0.5, 30000.0)
NODE = {"motor": 0, "bed": 1}


def programme(axis="X", feed=6000.0, stroke=400.0, n=3):
    standing = cycles.standing(CAN, n / 60.0)
    column = standing.column(axis)
    feeds, high = standing.feed_per_min.copy(), standing.stroke_high.copy()
    feeds[:, column] = feed
    high[:, column] = standing.stroke_low[:, column] + stroke
    return replace(standing, feed_per_min=feeds, stroke_high=high)


def heat(source, given):
    power = np.zeros((len(given), len(NODE)))
    source.add(power, given, NODE, np.ones(len(given)))
    return power


def to_and_fro(source, feed_per_min, stroke):
    """Return the share of a time in which an axis accelerates, from its path drawn out in small steps."""
    a, top = source.acceleration * 1e3, source.rapid_per_min / 60.0
    dt, position, speed, busy, time = 1e-5, 0.0, 0.0, 0, 0
    while position < stroke:
        brake = speed**2 / (2.0 * a) >= stroke - position
        change = -a if brake else a if speed < top else 0.0
        speed = max(speed + change * dt, a * dt)
        position += speed * dt
        busy += change != 0.0
        time += 1
    whole = stroke / (feed_per_min / 60.0) / dt  # with the rest that follows, at this mean feed
    assert whole > time
    return busy / whole


@pytest.mark.parametrize(("feed", "stroke"), [(6000.0, 400.0), (3000.0, 20.0), (12000.0, 800.0)])
def test_a_motor_accelerates_for_as_long_as_its_path_says(feed, stroke):
    got = MOTOR.duty(np.array([feed]), np.array([stroke]))[0]
    assert got == pytest.approx(to_and_fro(MOTOR, feed, stroke), rel=1e-2)


def test_its_loss_is_current_squared_times_resistance():
    current = 2000.0 * 5.0 / 500.0
    assert MOTOR.loss_W() == pytest.approx(current**2 * 0.5)
    power = heat(MOTOR, programme())
    duty = MOTOR.duty(np.array([6000.0]), np.array([400.0]))[0]
    np.testing.assert_allclose(power, np.tile([0.9, 0.1], (3, 1)) * duty * current**2 * 0.5)


def test_acceleration_costs_nothing_at_rest_and_more_in_short_strokes_up_to_its_peak():
    assert not heat(MOTOR, programme(feed=0.0)).any()
    strokes = np.array([800.0, 400.0, 200.0, 50.0, 1.0, 0.01])
    duty = MOTOR.duty(np.full(6, 6000.0), strokes)
    assert (np.diff(duty) >= 0.0).all()
    assert duty[1] == pytest.approx(2.0 * duty[0])
    assert duty[-1] == 1.0
    np.testing.assert_allclose(
        MOTOR.duty(np.array([8000.0]), strokes[:1]), 2.0 * MOTOR.duty(np.array([4e3]), strokes[:1])
    )


def test_a_rotary_axis_is_the_same_motion_in_radians():
    turn = replace(MOTOR, axis="C", rapid_per_min=np.rad2deg(30.0))
    slide = replace(MOTOR, rapid_per_min=30000.0)
    np.testing.assert_allclose(
        turn.duty(np.rad2deg(np.array([4.0])), np.rad2deg(np.array([0.3]))),
        slide.duty(np.array([4000.0]), np.array([300.0])),
    )
    assert heat(turn, programme("C", 3000.0, 90.0)).sum() > 0.0
    assert not heat(turn, programme("X", 3000.0, 90.0)).any()


def test_a_feed_source_warms_by_its_own_axis():
    source = FeedSource("C", PowerLaw(100.0, 6000.0, 1.0), {"motor": 1.0})
    np.testing.assert_allclose(heat(source, programme("C", 3000.0))[:, 0], 50.0)
    assert not heat(source, programme("X", 3000.0)).any()


def test_a_run_up_and_stop_pass_the_rotors_energy_twice():
    source = SpindleStartSource({"motor": 1.0}, inertia_kg_m2=0.04, lost=0.3)
    given = replace(programme(feed=0.0, n=4), speed_rpm=np.array([6000.0, 6000.0, 0.0, 3000.0]))
    given = replace(given, starts=np.array([1.0, 0.0, 0.0, 2.0]))
    energy = 0.5 * 0.04 * (2.0 * np.pi * np.array([100.0, 100.0, 0.0, 50.0])) ** 2
    np.testing.assert_allclose(heat(source, given)[:, 0] * 60.0, 0.3 * 2.0 * energy * given.starts)


@pytest.mark.parametrize("name", DESIGNS)
def test_a_designs_sources_warm_in_every_cycle_and_only_then(name):
    design = open_shop(name).design
    standing = design.heat(cycles.standing(design.capability, 0.1))
    assert np.ptp(standing, axis=0).max() == 0.0
    for kind in cycles.order(open_shop(name).machine):
        given = cycles.make(kind, design.capability, 8.0, np.random.default_rng(0))
        power = design.heat(given)
        assert np.isfinite(power).all()
        assert (power >= standing[0] - 1e-12).all()
        assert power.sum() > standing.sum(axis=1)[0] * len(given) or kind == "etve"


@pytest.mark.parametrize("name", DESIGNS)
def test_heat_in_is_heat_stored_and_heat_out_over_a_whole_run(name):
    """Boundary heat is integrated exactly over each held interval, from a matrix exponential of its own.

    exp of [[A, I, 0], [0, 0, I], [0, 0, 0]] t holds exp(A t), its integral and its double integral, so that
    ∫ T dt over an interval follows from T at its start and what is held.
    """
    design = open_shop(name).design
    network, period_s = design.network, 60.0
    given = cycles.make("shop", design.capability, 8.0, np.random.default_rng(2))
    boundary = surroundings(SHOP, MONDAY_MORNING, len(given), period_s, np.random.default_rng(3))
    power = design.heat(given)
    points, which = given.operating_points(design.capability.top_rpm)
    start = network.steady(REST, 0.0 * power[0], boundary[0])
    nodes = network.run(start, points, which, power, boundary, period_s)
    n, inverse = len(network.nodes), 1.0 / network.capacity()
    out = 0.0
    for k, point in enumerate(points):
        at = which == k
        between, to_boundary = network.conductances(point)
        block = np.zeros((3 * n, 3 * n))
        block[:n, :n] = -between * inverse[:, None]
        block[:n, n : 2 * n] = block[n : 2 * n, 2 * n :] = np.eye(n)
        full = expm(block * period_s)
        once, twice = full[:n, n : 2 * n], full[:n, 2 * n :]
        rate = (power[at] + boundary[at] @ to_boundary.T) * inverse
        integral = nodes[:-1][at] @ once.T + rate @ twice.T  # ∫ T dt, shape (., N)
        out += (integral @ to_boundary).sum() - (boundary[at] @ to_boundary.T).sum() * period_s
    stored = network.capacity() @ (nodes[-1] - nodes[0])
    np.testing.assert_allclose(stored + out, power.sum() * period_s, rtol=1e-9)


@pytest.mark.parametrize("period_s", [1.0, 10.0, 300.0])
def test_the_same_seed_at_another_period_is_the_same_run(period_s):
    usual, other = (
        simulate(VMC3, "r", "shop", (4, 0), 2.0, period_s=p, terms_period_s=300.0) for p in (60.0, period_s)
    )
    at, there = (np.isin(run.time_s, np.intersect1d(usual.time_s, other.time_s)) for run in (usual, other))
    assert at.sum() == there.sum() == (25 if period_s > 60.0 else 121)
    np.testing.assert_allclose(other.nodes_degC[there], usual.nodes_degC[at], rtol=1e-9)
    np.testing.assert_array_equal(other.terms_time_s, usual.terms_time_s)
    for axis in "XYZ":
        np.testing.assert_allclose(other.terms.motion[axis], usual.terms.motion[axis], atol=1e-6)
    np.testing.assert_allclose(other.terms.location["T"], usual.terms.location["T"], atol=1e-6)
    for name, values in usual.channels.items():
        mean = np.mean(values[1:121])
        assert np.mean(other.channels[name][1:]) == pytest.approx(mean), name
    for name, values in usual.sensors.items():
        late = 0.5 + 2e-3 * abs(
            period_s - 60.0
        )  # noise and rounding, and a lag that sees straight lines between samples
        assert np.abs(other.sensors[name][there] - values[at]).max() < late, name


@pytest.mark.parametrize("period_s", [5.0, 600.0])
def test_channels_are_means_over_the_period_before(period_s):
    usual, other = (simulate(VMC3, "r", "shop", (4, 1), 3.0, p, 600.0) for p in (60.0, period_s))
    fine = np.repeat(usual.channels["feed_x"][1:], 12)  # every 5 s
    k = round(period_s / 5.0)
    np.testing.assert_allclose(other.channels["feed_x"][1:], fine.reshape(-1, k).mean(axis=1))
    assert other.channels["feed_x"][0] == 0.0


@pytest.mark.parametrize("period_s", [0.0, -60.0, 0.5, 7.0, 45.0, 90.0, 7200.0, float("nan"), float("inf")])
def test_a_period_goes_with_the_minute(period_s):
    with pytest.raises(InputError, match=r"^period must be 1 to 60 s and divide a minute, or be whole minutes"):
        check_periods(period_s, 300.0)


@pytest.mark.parametrize("terms_s", [0.0, -300.0, 90.0, 30.0, float("nan")])
def test_error_terms_come_with_telemetry(terms_s):
    with pytest.raises(InputError, match=r"^period of error terms must be a multiple of 60 s, got"):
        check_periods(60.0, terms_s)


def test_the_steps_that_are_kept_are_few():
    """All operating points of a machine; each is an exponential that a run would else work out anew."""
    shop = open_shop("vmc3")
    for i, kind in enumerate(cycles.order(shop.machine)):
        simulate(shop, "r", kind, (0, i), 12.0)
    assert len(shop.design.network._steps) <= 9 * 8
    assert all(isinstance(point, OperatingPoint) for point, _ in shop.design.network._steps)
