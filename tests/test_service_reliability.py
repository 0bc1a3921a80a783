import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.reliability import EDGE_K, beyond, freshness_weight, range_weight, replacement_weight
from service.status import Condition, Status, most_serious


def test_fresh_telemetry_counts_in_full_and_then_fades_evenly() -> None:
    weights = [freshness_weight(age, 600.0, 1800.0) for age in (0.0, 600.0, 1050.0, 1500.0, 2400.0, 1e9)]
    assert weights == pytest.approx([1.0, 1.0, 0.75, 0.5, 0.0, 0.0])


def test_a_quarter_of_the_sensors_can_be_replaced_and_half_of_them_not() -> None:
    assert replacement_weight(3, 12) == 1.0
    assert 0.0 < replacement_weight(4, 12) < 1.0
    assert replacement_weight(6, 12) == 0.0
    assert replacement_weight(1, 1) == 0.0
    assert replacement_weight(0, 0) == 1.0


def test_a_temperature_may_leave_its_trained_range_by_a_little() -> None:
    assert range_weight(EDGE_K, 30.0) == 1.0
    assert range_weight(8.5, 30.0) == pytest.approx(0.5)
    assert range_weight(15.0, 30.0) == 0.0
    assert range_weight(2.0 * EDGE_K, 0.1) == 0.0  # a range too narrow for that rule
    assert [beyond(v, 10.0, 20.0) for v in (4.0, 15.0, 23.0)] == [6.0, 0.0, 3.0]


@given(st.floats(), st.floats(0.0, 100.0))
def test_every_weight_is_between_nothing_and_all(value: float, width: float) -> None:
    for weight in (freshness_weight(value, 600.0, 1800.0), range_weight(value, width)):
        assert 0.0 <= weight <= 1.0
    assert freshness_weight(math.nan, 600.0, 1800.0) == 0.0


def test_the_most_serious_condition_is_the_status() -> None:
    assert most_serious([]) == Status.OK
    found = [Condition(s, None) for s in (Status.DEGRADED, Status.STALE, Status.WARMING_UP)]
    assert most_serious(found) == Status.STALE
