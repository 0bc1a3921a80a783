import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from model.exceptions import DataError
from model.sensors import SensorModel, is_covariance

RNG = np.random.default_rng(6)
COMMON = RNG.normal(0, 5, (4000, 1))
READINGS = 25.0 + np.concatenate([COMMON, 2 * COMMON, -COMMON, RNG.normal(0, 5, (4000, 1))], axis=1)
FITTED = SensorModel.fit(READINGS)


def test_a_sensor_is_estimated_from_those_it_moves_with() -> None:
    sample = np.array([np.nan, 35.0, 20.0, 25.0])  # the common cause is +5 K
    assert FITTED.fill(sample)[0] == pytest.approx(30.0, abs=0.1)


def test_an_unrelated_sensor_is_estimated_by_its_mean() -> None:
    assert FITTED.fill(np.array([30.0, 35.0, 20.0, np.nan]))[3] == pytest.approx(FITTED.mean[3], abs=0.5)


@given(st.lists(st.booleans(), min_size=4, max_size=4))
def test_readings_stay_and_nothing_is_nan(missing: list[bool]) -> None:
    sample = np.where(missing, np.nan, READINGS[0])
    filled = FITTED.fill(sample)
    assert np.isfinite(filled).all()
    np.testing.assert_array_equal(filled[~np.array(missing)], READINGS[0][~np.array(missing)])


def test_all_missing_is_the_mean() -> None:
    np.testing.assert_allclose(FITTED.fill(np.full(4, np.nan)), FITTED.mean)


def test_batch_is_loop() -> None:
    readings = READINGS[:50].copy()
    readings[RNG.random(readings.shape) < 0.3] = np.nan
    np.testing.assert_allclose(FITTED.fill(readings), [FITTED.fill(row) for row in readings], atol=1e-10)


def test_gaps_in_training_bias_nothing() -> None:
    readings = READINGS.copy()
    readings[RNG.random(readings.shape) < 0.2] = np.nan
    np.testing.assert_allclose(SensorModel.fit(readings).mean, FITTED.mean, atol=0.3)


def test_gaps_leave_a_covariance_and_estimates_that_beat_the_mean() -> None:
    """Three of four readings are missing at random, so each pair of sensors was seen on samples of its own."""
    rng = np.random.default_rng(0)
    truth = 25.0 + rng.normal(0, 4, (3000, 2)) @ rng.normal(0, 1, (2, 10)) + rng.normal(0, 0.1, (3000, 10))
    missing = rng.random(truth.shape) < 0.75
    fitted = SensorModel.fit(np.where(missing, np.nan, truth))
    assert np.linalg.eigvalsh(fitted.covariance)[0] >= -1e-9
    np.testing.assert_allclose(np.diag(fitted.covariance), truth.var(axis=0), rtol=0.15)
    error = (fitted.fill(np.where(missing, np.nan, truth)) - truth)[missing]
    assert np.sqrt((error**2).mean()) < 0.6 * truth.std()


def test_a_sensor_that_never_moves_and_ones_never_read_together() -> None:
    readings = READINGS.copy()
    readings[:, 3] = 20.0
    readings[::2, :2] = np.nan
    readings[1::2, 2:] = np.nan
    fitted = SensorModel.fit(readings)
    assert fitted.covariance[3, 3] == 0.0
    assert np.isfinite(fitted.fill(readings)).all()
    assert is_covariance(fitted.covariance)
    assert not is_covariance(np.array([[1.0, 2.0], [2.0, 1.0]]))
    assert not is_covariance(np.array([[1.0, 0.5], [0.2, 1.0]]))


def test_a_sensor_without_readings_is_refused() -> None:
    readings = READINGS.copy()
    readings[:, 2] = np.nan
    with pytest.raises(DataError, match="each sensor must have readings, got none in column 2"):
        SensorModel.fit(readings)
