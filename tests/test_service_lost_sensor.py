"""The service believes a prediction as far as the bundle says that it may with sensors lost."""

from pathlib import Path

import numpy as np
import pytest
from lost import bundle_with, untold_record

from model.bundle import Bundle, load_bundle
from model.predictor import Predictor
from service.schemas import Sample
from service.settings import Settings
from service.status import Status
from service.thermal import Thermal

START_S = 1.7e9
READINGS = {"spindle": 24.0, "column": 22.0, "ambient": 20.0}


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    folder = tmp_path_factory.mktemp("lost")
    bundle_with(folder, untold_record())
    return load_bundle(folder / "bundle")


def thermal_of(bundle: Bundle) -> Thermal:
    assert bundle.manifest.network is not None
    return Thermal(Predictor(bundle), bundle.manifest.network, bundle.machine)


def serve(thermal: Thermal, minutes: range, lost: tuple[str, ...] = ()) -> tuple[float, set[Status]]:
    """Return the weight of the thermal part, and what is said, after a sample each minute."""
    for minute in minutes:
        wobble = 0.2 * np.sin(minute)  # readings that never move are stuck
        temperatures = {n: None if n in lost else t + wobble for n, t in READINGS.items()}
        assert thermal.take(Sample(time=START_S + 60.0 * minute, temperatures=temperatures))
    assert thermal.state is not None
    weight, conditions = thermal.outlook(thermal.state.time_s, Settings())
    return weight, {c.status for c in conditions}


def test_the_weight_is_the_reliability_that_the_bundle_states(bundle: Bundle) -> None:
    thermal = thermal_of(bundle)
    whole, _ = serve(thermal, range(60))
    assert whole == 1.0
    weights = []
    for hour in range(1, 5):
        weight, said = serve(thermal, range(60 * hour, 60 * hour + 60), ("column",))
        assert thermal.state is not None
        missed = thermal.predictor.missed(thermal.state)
        assert missed is not None
        assert weight == missed.reliability
        assert Status.DEGRADED in said
        weights.append(weight)
    assert weights == sorted(weights, reverse=True)
    assert 0.0 < weights[-1] < 1.0
    sentences = [c.sentence for c in thermal.outlook(START_S + 300 * 60.0, Settings())[1] if c.sentence]
    estimate = thermal.state.inputs[1] if thermal.state is not None else np.nan
    assert f"sensor 'column' has no reading; replaced by its estimate {estimate:.1f} °C" in sentences


def test_with_most_sensors_gone_nothing_of_the_thermal_part_is_left(bundle: Bundle) -> None:
    thermal = thermal_of(bundle)
    serve(thermal, range(60))
    assert serve(thermal, range(60, 62), ("column", "ambient"))[0] == 0.0
    assert serve(thermal, range(62, 64), tuple(READINGS))[0] == 0.0
    assert thermal.state is not None
    assert np.isfinite(thermal.state.coefficients).all()


def test_one_that_is_there_from_the_start_with_a_sensor_missing_says_so(bundle: Bundle) -> None:
    weight, said = serve(thermal_of(bundle), range(3), ("column",))
    assert 0.0 < weight < 1.0
    assert Status.DEGRADED in said


def test_what_is_remembered_of_lost_sensors_goes_on(bundle: Bundle, tmp_path: Path) -> None:
    """As a restart does: the state is all there is."""
    one, other = thermal_of(bundle), thermal_of(bundle)
    serve(one, range(30))
    serve(one, range(30, 60), ("column",))
    other.recall(one.memory())
    assert serve(one, range(60, 90)) == serve(other, range(60, 90))
    assert one.state is not None
    assert other.state is not None
    np.testing.assert_array_equal(one.state.coefficients, other.state.coefficients)
    np.testing.assert_array_equal(one.state.doubt, other.state.doubt)
