from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_synth.environment import lag
from data_synth.machines import DESIGNS, open_shop
from data_synth.run import simulate
from data_synth.sensors import CHECKED_H, EXACT, Calibration, Thermometer, rounded

RNG = np.random.default_rng(3)


def ideal(**changes):
    """Return a thermometer without any fault of its own, but for `changes`."""
    kept = {"lag_s": 0.0, "noise_K": 0.0, "step_K": 0.0, "offset_K": 0.0, "gain": 0.0, "drift_K": 0.0}
    return Thermometer({"node": 1.0}, **kept | changes)


def shown(meter, truth, period_s=60.0, calibration=EXACT, seed=0):
    return meter.read({"node": truth}, period_s, np.random.default_rng(seed), calibration)


def test_an_ideal_thermometer_shows_the_truth_of_where_it_sits():
    truth = RNG.uniform(15.0, 60.0, 50)
    np.testing.assert_array_equal(shown(ideal(), truth), truth)
    between = Thermometer({"a": 0.25, "b": 0.75}, 0.0, 0.0, 0.0, drift_K=0.0)
    got = between.read({"a": truth, "b": truth + 8.0}, 60.0, RNG)
    np.testing.assert_allclose(got, truth + 6.0)


@settings(deadline=None)
@given(lag_s=st.floats(1.0, 1000.0), period_s=st.floats(0.5, 600.0), jump=st.floats(-40.0, 40.0))
def test_after_a_straight_rise_the_lag_falls_off_as_exp(lag_s, period_s, jump):
    """First-order lag of a ramp over one period, then held: the analytic answer."""
    truth = np.concatenate([[20.0], np.full(30, 20.0 + jump)])
    time = np.arange(31) * period_s
    after_ramp = 20.0 + jump * (1.0 - (1.0 - np.exp(-period_s / lag_s)) * lag_s / period_s)
    expected = 20.0 + jump + (after_ramp - 20.0 - jump) * np.exp(-(time[1:] - period_s) / lag_s)
    np.testing.assert_allclose(shown(ideal(lag_s=lag_s), truth, period_s)[1:], expected, atol=1e-9)


def test_a_finer_period_shows_the_same_of_a_temperature_that_runs_straight():
    knots = RNG.uniform(20.0, 40.0, 30)
    fine = np.interp(np.arange(29 * 6 + 1) / 6.0, np.arange(30), knots)
    np.testing.assert_allclose(lag(fine, 90.0, 10.0)[::6], lag(knots, 90.0, 60.0), atol=1e-9)


@pytest.mark.parametrize("step_K", [0.1, 0.0625, 0.5])
def test_rounding_errs_evenly_up_to_half_a_step(step_K):
    truth = np.linspace(20.0, 50.0, 20011)
    error = shown(ideal(step_K=step_K), truth) - truth
    assert np.abs(error).max() <= step_K / 2 + 1e-6
    assert error.mean() == pytest.approx(0.0, abs=step_K / 50)
    assert error.std() == pytest.approx(step_K / np.sqrt(12.0), rel=0.02)
    counts, _ = np.histogram(error, 10, (-step_K / 2, step_K / 2))
    assert counts.min() > 0.8 * counts.max()


@given(st.floats(-50.0, 200.0), st.sampled_from([0.1, 0.01, 0.25]))
def test_rounded_numbers_stay_as_they_are(value, step_K):
    once = rounded(np.array([value]), step_K)
    np.testing.assert_array_equal(rounded(once, step_K), once)
    assert len(f"{once[0]:.15g}") <= 7


@pytest.mark.parametrize("period_s", [1.0, 60.0, 300.0])
def test_noise_has_its_spread_at_any_period_and_does_not_remember(period_s):
    error = shown(ideal(noise_K=0.05), np.full(20000, 20.0), period_s) - 20.0
    assert error.std() == pytest.approx(0.05, rel=0.03)
    assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 0.03


@pytest.mark.parametrize("period_s", [60.0, 1200.0])
def test_drift_grows_as_the_root_of_time_whatever_the_period(period_s):
    n = round(40 * 3600.0 / period_s) + 1
    meter = ideal(drift_K=0.05)
    walks = np.array([shown(meter, np.full(n, 20.0), period_s, seed=seed) - 20.0 for seed in range(800)])
    np.testing.assert_array_equal(walks[:, 0], 0.0)
    hours = np.arange(n) * period_s / 3600.0
    for at in (n // 4, n // 2, n - 1):
        assert walks[:, at].std() == pytest.approx(0.05 * np.sqrt(hours[at] / 1000.0), rel=0.1)
    assert abs(walks.mean(axis=0)).max() < 4 * walks[:, -1].std() / np.sqrt(len(walks))


def test_a_calibration_moves_and_stretches():
    truth = np.array([0.0, 100.0])
    np.testing.assert_allclose(shown(ideal(), truth, calibration=Calibration(0.2, 0.005)), [0.2, 100.7])


def test_a_machine_keeps_its_thermometers_and_another_has_others():
    meter = Thermometer({"node": 1.0})
    one = meter.calibrated("vmc3/motor", 4, 100.0)
    assert one == meter.calibrated("vmc3/motor", 4, 100.0)
    later = meter.calibrated("vmc3/motor", 4, 2000.0)
    assert later.gain == one.gain
    assert 0.0 < abs(later.offset_K - one.offset_K) < 4 * meter.drift_K * np.sqrt(1.9)
    for other in (("vmc3/head", 4), ("vmc3~1/motor", 4), ("vmc3/motor", 5)):
        assert meter.calibrated(*other, 100.0).gain != one.gain


def test_thermometers_leave_the_factory_within_class_b():
    meter = Thermometer({"node": 1.0})
    new = [meter.calibrated(f"m/{i}", 0, 0.0) for i in range(1000)]
    offset, gain = np.array([(c.offset_K, c.gain) for c in new]).T
    for value, limit in ((offset, 0.3), (gain, 0.005)):
        assert np.abs(value).max() <= limit
        assert value.std() == pytest.approx(limit / np.sqrt(3.0), rel=0.1)
    assert abs(np.corrcoef(offset, gain)[0, 1]) < 0.1


def test_thermometers_age_as_the_root_of_time_between_checks():
    meter = ideal(drift_K=0.05)
    ages = (1000.0, 4000.0, CHECKED_H)
    found = np.array([[meter.calibrated(f"m/{i}", 0, age).offset_K for age in ages] for i in range(600)])
    np.testing.assert_allclose(found.std(axis=0), 0.05 * np.sqrt(np.array(ages) / 1000.0), rtol=0.12)
    # The same thermometer: what it was off by in spring is still in it in autumn.
    assert np.corrcoef(found[:, 0], found[:, 1])[0, 1] == pytest.approx(0.5, abs=0.12)


@pytest.mark.parametrize("name", DESIGNS)
def test_each_sensor_sits_on_nodes_whose_shares_are_whole(name):
    design = DESIGNS[name]
    known = {*design.network.nodes, *design.network.boundaries}
    for meter in design.thermometers.values():
        assert set(meter.at) <= known
        assert sum(meter.at.values()) == pytest.approx(1.0)
        assert min(meter.at.values()) > 0.0


def test_all_runs_of_a_data_set_have_the_same_thermometers():
    """What each is off by stays from one day to another, but for its walk; another data set has others."""
    shop = open_shop("vmc3")
    inside = set(shop.design.network.nodes)
    meters = {s: m for s, m in shop.design.thermometers.items() if set(m.at) <= inside}
    off = np.zeros((4, 3, len(meters)))
    for data, day in np.ndindex(off.shape[:2]):
        run = simulate(shop, "r", "shop", (data, day), 2.0)
        felt = dict(zip(shop.design.network.nodes, run.nodes_degC.T, strict=True))
        for k, (name, meter) in enumerate(meters.items()):
            truth = replace(meter, noise_K=0.0, step_K=0.0, drift_K=0.0).read(felt, 60.0, RNG)
            off[data, day, k] = np.mean(run.sensors[name] - truth)
    within = off.std(axis=1, ddof=1)
    between = off.mean(axis=1).std(axis=0, ddof=1)
    assert rms(within) < 0.5 * rms(between)
    assert rms(between) == pytest.approx(np.hypot(0.3, 0.005 * 25.0) / np.sqrt(3.0), rel=0.4)
    # Two days lie a third of a year apart in the mean; half the square of their difference is the variance.
    assert rms(within) == pytest.approx(0.05 * np.sqrt(8760.0 / 3.0 / 2.0 / 1000.0), rel=0.5)


def rms(values):
    return np.sqrt(np.mean(values**2))
