"""Drift: a sequential test whose false alarms are counted, and the measurements it is made of."""

import math
from dataclasses import replace

import numpy as np
import pytest

from service.measurements.drift import (
    DAY_S,
    FALSE_ALARMS,
    LIMIT_SD,
    MEMORY,
    REFERENCE,
    SESSION_S,
    Compared,
    Drift,
    assess,
)

HERE = (400.0, 250.0, 100.0)
THERE = (100.0, 50.0, 300.0)
FIRST_S = 1.8e9


def probings(
    residual_um: np.ndarray, sd_um: float = 2.0, every_s: float = SESSION_S, place: tuple[float, ...] = HERE
) -> list[Compared]:
    """One probing a session; residuals of shape (n, 3)."""
    return [
        Compared(FIRST_S + every_s * n, place, (float(x), float(y), float(z)), sd_um)
        for n, (x, y, z) in enumerate(residual_um)
    ]


def noise(rng: np.random.Generator, count: int, sd_um: float = 2.0) -> np.ndarray:
    return rng.normal(0.0, sd_um, (count, 3))


def test_calibrated_noise_alarms_no_more_often_than_stated() -> None:
    rng = np.random.default_rng(0)
    trials, length = 150, 22
    alarms = sum(
        assess(probings(residual[:n])).drifting
        for residual in (noise(rng, length) for _ in range(trials))
        for n in range(REFERENCE + 1, length + 1)
    )
    looked = trials * (length - REFERENCE)
    # Alarms come in runs of some five sessions, which widens their spread.
    assert alarms <= FALSE_ALARMS * looked + 3.0 * math.sqrt(5.0 * FALSE_ALARMS * looked)


def test_the_limit_is_that_of_the_stated_rate() -> None:
    """The running residual's standard deviation, by simulation, against the limit that is stated for it."""
    rng = np.random.default_rng(1)
    found = [assess(probings(noise(rng, 18))).components[0] for _ in range(600)]
    assert LIMIT_SD * np.std([c.running_um or 0.0 for c in found]) == pytest.approx(found[0].limit_um, rel=0.1)


def test_sessions_that_share_a_datum_share_its_error() -> None:
    """Two datums: what the second one's sessions have in common has to be in the limit."""
    rng = np.random.default_rng(2)
    running = []
    for _ in range(600):
        shared = rng.normal(0.0, 3.0, (2, 3))
        residual = noise(rng, 20) - np.repeat(shared, 10, axis=0)
        epochs = np.repeat([FIRST_S - 10.0, FIRST_S + 10 * SESSION_S - 10.0], 10)
        compared = [
            replace(c, datum_sd_um=3.0, datum_s=float(s)) for c, s in zip(probings(residual), epochs, strict=True)
        ]
        running.append(assess(compared).components[2])
    assert LIMIT_SD * np.std([c.running_um or 0.0 for c in running]) == pytest.approx(running[0].limit_um, rel=0.1)


def test_probings_of_one_session_count_as_one() -> None:
    """They are wrong in the same way: a hundred of them say no more than one."""
    rng = np.random.default_rng(3)
    residual = noise(rng, 15)
    once = assess(probings(residual))
    often = [
        replace(c, time_s=c.time_s + 60.0 * k) for c in probings(residual, every_s=2 * SESSION_S) for k in range(50)
    ]
    again = assess(often)
    for a, b in zip(once.components, again.components, strict=True):
        assert b.running_um == pytest.approx(a.running_um)
        assert b.limit_um == pytest.approx(a.limit_um)
        assert b.sessions == a.sessions == 15


@pytest.mark.parametrize("component", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_shift_of_three_standard_deviations_is_found_within_ten_sessions(component: int, sign: float) -> None:
    rng = np.random.default_rng(4)
    late = 0
    for _ in range(60):
        residual = noise(rng, 22)
        residual[12:, component] += sign * 3.0 * 2.0
        late += not any(assess(probings(residual[:n])).components[component].drifting for n in range(22, 12, -1))
    assert late <= 3


def test_a_constant_offset_is_geometry_and_no_drift() -> None:
    rng = np.random.default_rng(5)
    residual = noise(rng, 20)
    plain, shifted = assess(probings(residual)), assess(probings(residual + np.array([500.0, -80.0, 12.0])))
    for a, b in zip(plain.components, shifted.components, strict=True):
        assert b.running_um == pytest.approx(a.running_um)
        assert b.trend_um_per_day == pytest.approx(a.trend_um_per_day)
    assert not shifted.drifting


def test_each_place_has_an_offset_of_its_own() -> None:
    rng = np.random.default_rng(6)
    residual = noise(rng, 12, 0.01)
    here = probings(residual, 0.01)
    there = [replace(c, time_s=c.time_s + 60.0) for c in probings(residual + 40.0, 0.01, place=THERE)]
    assert not assess(here + there).drifting
    mixed = [replace(c, place=HERE) if n >= 6 else c for n, c in enumerate(there)]
    assert assess(here[:6] + mixed).drifting


def test_nothing_is_said_before_a_place_has_its_reference() -> None:
    early = assess(probings(1000.0 * noise(np.random.default_rng(7), REFERENCE)))
    assert not early.drifting
    assert {(c.running_um, c.limit_um, c.sessions) for c in early.components} == {(None, None, REFERENCE)}
    assert assess([]) == Drift()


def test_a_component_that_is_not_measured_is_left_open() -> None:
    residual = noise(np.random.default_rng(8), 10)
    residual[:, 1] = math.nan
    x, y, z = assess(probings(residual)).components
    assert (y.running_um, y.limit_um, y.trend_um_per_day, y.sessions) == (None, None, None, 0)
    for whole, left_out in zip(assess(probings(np.nan_to_num(residual))).components[::2], (x, z), strict=True):
        assert left_out == whole


def test_the_running_residual_is_an_exponentially_weighted_mean() -> None:
    residual = np.zeros((REFERENCE + 3, 3))
    residual[REFERENCE:, 0] = [1.0, 2.0, 4.0]
    weights = MEMORY * (1.0 - MEMORY) ** np.array([2.0, 1.0, 0.0])
    running = assess(probings(residual)).components[0].running_um
    assert running == pytest.approx((weights * [1.0, 2.0, 4.0]).sum() / weights.sum())


def test_the_trend_is_the_slope_with_its_standard_error() -> None:
    rng = np.random.default_rng(9)
    found = []
    for _ in range(200):
        residual = noise(rng, 20)
        residual[:, 1] += 1.5 * SESSION_S / DAY_S * np.arange(20)
        found.append(assess(probings(residual)).components[1])
    slopes = np.array([c.trend_um_per_day for c in found])
    assert slopes.mean() == pytest.approx(1.5, abs=4.0 * slopes.std() / math.sqrt(len(slopes)))
    assert np.mean([c.trend_sd_um_per_day for c in found]) == pytest.approx(slopes.std(), rel=0.1)


def test_the_order_of_measurements_does_not_matter() -> None:
    compared = probings(noise(np.random.default_rng(10), 15))
    assert assess(reversed(compared)) == assess(compared)
