"""A lost sensor's value and modes are estimated from all other inputs: by laws of normal distributions and of lags."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lost import (
    COLUMN,
    FEATURES,
    MODES,
    SENSORS,
    SOURCES,
    TAU_S,
    TINY,
    bundle_with,
    losing,
    record_of,
    telemetry,
    untold_record,
)

from model.bundle import load_bundle
from model.exceptions import BundleError
from model.lost_sensors import PATTERNS, LostSensors, stepped_doubt
from model.manifest import LostSensorRecord
from model.predictor import Predictor, ThermalState
from model.transforms import Array


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Predictor:
    """Return the tiny bundle, which knows that the column lies halfway between the others."""
    plain = Predictor(load_bundle(TINY))
    return bundle_with(tmp_path_factory.mktemp("told"), record_of(plain.states(telemetry(0, told=True))))


@pytest.fixture(scope="module")
def untold(tmp_path_factory: pytest.TempPathFactory) -> Predictor:
    """Return the same for a column that the others tell a little of."""
    plain = Predictor(load_bundle(TINY))
    states = plain.states(telemetry(0, told=False))
    return bundle_with(tmp_path_factory.mktemp("untold"), record_of(states, noise=0.01))


def coefficients(states: list[ThermalState]) -> Array:
    return np.array([state.coefficients for state in states])


def test_with_nothing_lost_nothing_changes(told: Predictor) -> None:
    run = telemetry(1, told=False)
    states = told.states(run)
    np.testing.assert_array_equal(coefficients(states), Predictor(load_bundle(TINY)).follow(run))
    assert not any(state.doubt.any() for state in states)
    missed = told.missed(states[-1])
    assert missed is not None
    assert missed.reliability == 1.0


@pytest.mark.parametrize("start", [0, 80])
def test_what_the_others_tell_wholly_is_not_missed(told: Predictor, start: int) -> None:
    """A lag of a linear function is the linear function of the lags, whatever the steps."""
    run = telemetry(2, told=True)
    there, gone = told.states(run), told.states(losing(run, [COLUMN], start))
    np.testing.assert_allclose(coefficients(gone), coefficients(there), atol=1e-3)
    np.testing.assert_allclose([s.inputs for s in gone], [s.inputs for s in there], atol=1e-3)


def test_without_the_record_the_temperature_of_the_moment_is_filled_in(tmp_path: Path) -> None:
    run = losing(telemetry(2, told=True), [COLUMN])
    plain = bundle_with(tmp_path, None)
    filled = dataclasses.replace(run, temperatures=plain.sensor_model.fill(run.temperatures))
    np.testing.assert_allclose(plain.follow(run), plain.follow(filled), atol=1e-12)
    assert plain.missed(plain.states(run)[-1]) is None


def test_a_loss_does_not_jump_and_is_forgotten_in_time(untold: Predictor) -> None:
    """The moment after, all is as before, however far the sensor is from what the others suggest."""
    run = telemetry(3, told=False)
    run.temperatures[:, COLUMN] += 15.0
    state = untold.states(run)[-1]
    nothing = np.array([np.nan])
    readings = np.concatenate([run.temperatures[-1, :1], nothing, run.temperatures[-1, 2:]])
    soon = untold.step(state, state.time_s + 1e-3, readings, run.channels[-1])
    np.testing.assert_allclose(soon.coefficients, state.coefficients, atol=1e-3)
    assert soon.doubt[COLUMN].max() < 1e-4
    late = untold.step(soon, state.time_s + 1e7, readings, run.channels[-1])
    still = untold.start(0.0, readings, run.channels[-1])
    assert late.doubt[COLUMN] == pytest.approx(1.0)
    assert abs(late.inputs[COLUMN] - state.inputs[COLUMN]) > 5.0
    assert abs(still.inputs[COLUMN] - state.inputs[COLUMN]) > 5.0


@settings(max_examples=25, deadline=None)
@given(st.floats(1.0, 1e4), st.floats(0.05, 0.95), st.sampled_from([[0], [1], [0, 2], [0, 1, 2]]))
def test_one_step_is_two_half_steps(dt_s: float, share: float, lost: list[int]) -> None:
    predictor = cached_untold()
    run = telemetry(4, told=False)
    state = predictor.states(losing(run, [lost[0]], 200))[-1]
    now = run.temperatures[-1]
    target = now + np.array([3.0, -2.0, 1.0])
    between = now + share * (target - now)
    now[lost] = target[lost] = between[lost] = np.nan
    # Temperatures are linear in time from now to the target; the channel is held, so that heat is linear, too.
    started = predictor.step(state, state.time_s, now, run.channels[-1])
    once = predictor.step(started, started.time_s + dt_s, target, run.channels[-1])
    half = predictor.step(started, started.time_s + share * dt_s, between, run.channels[-1])
    twice = predictor.step(half, started.time_s + dt_s, target, run.channels[-1])
    np.testing.assert_allclose(twice.coefficients, once.coefficients, atol=1e-7)
    np.testing.assert_allclose(twice.modes, once.modes, atol=1e-7)
    np.testing.assert_allclose(twice.doubt, once.doubt, atol=2e-6)


CACHE: list[Predictor] = []


def cached_untold() -> Predictor:
    return CACHE[0]


@pytest.fixture(autouse=True, scope="module")
def keep(untold: Predictor) -> None:
    CACHE[:] = [untold]


def test_when_it_is_back_its_value_counts_at_once_and_its_modes_come_to_agree(untold: Predictor) -> None:
    run = telemetry(6, told=False)
    back = losing(run, [COLUMN], 60, 120)
    states, whole = untold.states(back), untold.states(run)
    assert states[119].doubt[COLUMN].min() > 0.0
    assert states[120].doubt[COLUMN, 0] == 0.0
    elapsed_s = run.time_s[200] - run.time_s[120]
    faded = np.exp(-2.0 * elapsed_s / TAU_S)
    np.testing.assert_allclose(states[200].doubt[COLUMN, 1:], states[120].doubt[COLUMN, 1:] * faded, atol=1e-6)
    gaps = [np.abs(s.modes - w.modes).max() for s, w in zip(states, whole, strict=True)]
    assert gaps[59] == 0.0
    assert gaps[239] < 0.2 * gaps[120]
    assert np.abs(states[150].inputs - whole[150].inputs).max() == 0.0


def test_changes_since_the_start_know_nothing_of_a_sensor_that_was_never_there(
    tmp_path: Path, untold: Predictor
) -> None:
    """A network of run-start data starts at zero, in doubt of nothing, and no constant comes in with time."""
    record = untold_record().model_copy(update={"mean": [0.0] * FEATURES})
    changes = bundle_with(tmp_path, record, "run-start")
    readings, channels = np.array([24.0, np.nan, 19.0]), np.array([0.0])
    state = changes.start(0.0, readings, channels)
    assert not state.doubt.any()
    late = changes.step(state, 1e6, readings, channels)
    np.testing.assert_allclose(late.coefficients, state.coefficients, atol=1e-6)
    assert late.doubt[COLUMN] == pytest.approx(1.0)


def test_a_sensor_that_comes_later_counts_by_its_changes_alone(tmp_path: Path) -> None:
    """A network of run-start data cannot know what it read at the start, so it must not jump to its reading."""
    record = told_record().model_copy(update={"mean": [0.0] * FEATURES})
    changes = bundle_with(tmp_path, record, "run-start")
    run = telemetry(8, told=True)
    run.temperatures[:, COLUMN] += 12.0  # read too high all the time, as another machine's might
    there, late = changes.states(run), changes.states(losing(run, [COLUMN], 0, 100))
    np.testing.assert_allclose(
        coefficients(late) - late[0].coefficients, coefficients(there) - there[0].coefficients, atol=0.02
    )
    assert late[0].unseen.tolist() == [0.0, 1.0, 0.0]
    assert not late[-1].unseen.any()
    assert abs(late[-1].shift[COLUMN]) > 5.0
    again = changes.states(losing(losing(run, [COLUMN], 0, 100), [COLUMN], 150, 160))
    np.testing.assert_array_equal(again[-1].shift, late[-1].shift)
    assert not any(state.shift.any() or state.unseen.any() for state in there)


def told_record() -> LostSensorRecord:
    """Return statistics of changes since the start, where the column lies halfway between the others."""
    states = Predictor(load_bundle(TINY)).states(telemetry(0, told=True))
    return record_of(states)


@given(st.sets(st.integers(0, 2)), st.sets(st.integers(0, 2)), st.floats(0.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_reliability_never_grows_with_more_lost_or_more_doubt(some: set[int], others: set[int], less: float) -> None:
    predictor = cached_untold()
    state = predictor.start(0.0, np.array([22.0, 21.0, 20.0]), np.array([0.0]))

    def reliability(lost: set[int], share: float) -> float:
        doubt = np.zeros((SENSORS, 1 + MODES))
        doubt[sorted(lost)] = share
        missed = predictor.missed(dataclasses.replace(state, doubt=doubt))
        assert missed is not None
        return missed.reliability

    fewer, more = reliability(some, 1.0), reliability(some | others, 1.0)
    assert 0.0 <= more <= fewer + 1e-12 <= 1.0 + 1e-12
    assert reliability(some, less) >= fewer - 1e-12


def test_the_estimate_is_that_of_a_joint_normal_distribution() -> None:
    factors = np.random.default_rng(5).normal(size=(4, FEATURES))
    record = untold_record().model_copy(update={"factors": factors.tolist(), "noise": 0.3, "mean": [0.0] * FEATURES})
    lost = LostSensors(record, SENSORS, SOURCES, TAU_S)
    missing = np.array([True, False, True])
    found = lost.given(missing)
    covariance = factors.T @ factors + 0.3 * np.eye(FEATURES)
    m, k = found.lost, ~found.lost
    assert m.sum() == 2 * (1 + MODES)
    gain = np.linalg.solve(covariance[np.ix_(k, k)], covariance[np.ix_(k, m)])
    np.testing.assert_allclose(found.gain, gain, atol=1e-9)
    left = covariance[np.ix_(m, m)] - covariance[np.ix_(m, k)] @ gain
    np.testing.assert_allclose(found.roots.T @ found.roots, left, atol=1e-9)


def test_no_more_patterns_are_kept_than_said() -> None:
    lost = LostSensors(untold_record(), SENSORS, SOURCES, TAU_S)
    for number in range(8):
        lost.given(np.array([number & 1, number & 2, number & 4], dtype=bool))
    assert len(lost._patterns) == 8 <= PATTERNS
    first = lost.given(np.zeros(3, dtype=bool))
    assert lost.given(np.zeros(3, dtype=bool)) is first
    assert first.gain.shape == (FEATURES, 0)


def test_the_doubt_of_an_estimate_is_its_share_of_the_variance_of_an_ar1_process() -> None:
    """With e' = r e + sqrt(1 - r²) noise of unit variance, known at the start, Var e = 1 - r² after one step."""
    kept, faded = np.array([0.9, 0.5]), np.array([0.0, 0.8])
    doubt = np.zeros((2, 2))
    gone = np.array([True, False])
    for steps in range(1, 5):
        doubt = stepped_doubt(doubt, gone, kept, faded)
        np.testing.assert_allclose(doubt[0], 1.0 - kept ** (2 * steps))
    assert not doubt[1].any()
    np.testing.assert_allclose(stepped_doubt(doubt, ~gone, kept, faded)[0], doubt[0] * [0.0, 0.64])


def shorter(record: dict[str, list[Any]]) -> None:
    """Take a feature away."""
    record["mean"].pop()
    record["factors"] = [row[:-1] for row in record["factors"]]


@pytest.mark.parametrize("change", [shorter, lambda record: record["memory_s"].pop()])
def test_a_record_of_another_network_is_refused(
    tmp_path: Path, change: Callable[[dict[str, list[Any]]], object]
) -> None:
    content = untold_record().model_dump(mode="json")
    change(content)
    with pytest.raises(BundleError, match="lost sensors in the manifest must be told by 11 features of 3 sensors"):
        bundle_with(tmp_path, LostSensorRecord.model_validate(content))
