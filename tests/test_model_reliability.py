"""Reliability is a share of a variance, or the multiplier of the best estimate: by the laws of both."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from service_client import TINY

from model.fields import Fields
from model.machine import load_machine
from model.reliability import Missed, beyond_um, explained, shrunk, tip_rms_um
from model.tip_effects import tip_effects, tip_form

UM = st.floats(0.0, 1e6)


@given(UM, UM, UM, UM, UM)
def test_it_is_between_0_and_1_and_never_grows_with_what_is_missed(
    drift: float, lost: float, beyond: float, more_lost: float, more_beyond: float
) -> None:
    less = Missed(drift, lost, beyond).reliability
    more = Missed(drift, lost + more_lost, beyond + more_beyond).reliability
    assert 0.0 <= more <= less <= 1.0


def test_with_nothing_missed_it_is_1_and_with_numbers_that_are_none_0() -> None:
    assert Missed(0.0, 0.0, 0.0).reliability == 1.0
    assert Missed(10.0, 10.0, 0.0).reliability == 0.0
    for wrong in (math.nan, math.inf):
        assert explained(10.0, wrong) == shrunk(10.0, wrong) == 0.0
    assert explained(math.nan, 1.0) == shrunk(math.nan, 1.0) == 0.0
    assert explained(0.0, 1.0) == shrunk(0.0, 1.0) == 0.0


def test_the_multiplier_is_the_one_that_leaves_least() -> None:
    rng = np.random.default_rng(0)
    truth, error = rng.normal(0.0, 30.0, 200_000), rng.normal(0.0, 20.0, 200_000)
    left = {w: float(np.std(truth - w * (truth + error))) for w in np.linspace(0.0, 1.0, 101)}
    assert shrunk(30.0, 20.0) == pytest.approx(min(left, key=lambda w: left[w]), abs=0.02)


def test_the_share_is_that_of_a_regression() -> None:
    """What is missed of a conditional mean is independent of it, so the shares of the variance add up to 1."""
    rng = np.random.default_rng(1)
    told, missed = rng.normal(0.0, 40.0, 200_000), rng.normal(0.0, 20.0, 200_000)
    truth = told + missed
    assert explained(float(truth.std()), 20.0) == pytest.approx(np.corrcoef(told, truth)[0, 1] ** 2, abs=0.01)


def test_the_form_of_the_tip_is_its_mean_square_over_the_volume() -> None:
    fields = Fields(load_machine(TINY), ("EXX", "EC0Y", "EZ0T"), 2)
    directions = np.random.default_rng(2).normal(size=(3, fields.size))
    axes = [fields.machine.axes[a] for a in fields.machine.axis_names]
    grid = np.meshgrid(*(np.linspace(a.low, a.high, 5) for a in axes), indexing="ij")
    moved = tip_effects(fields, np.stack([g.ravel() for g in grid], axis=1)) @ directions.T
    rms = float(np.sqrt((moved**2).sum(axis=(1, 2)).mean()))
    assert tip_rms_um(directions, tip_form(fields)) == pytest.approx(rms, rel=1e-9)
    # Sizes add up in squares: three times the size, less the one that is usual, is the root of eight.
    assert beyond_um(3.0, 1.0, directions, tip_form(fields)) == pytest.approx(math.sqrt(8.0) * rms)
    assert beyond_um(1.0, 1.0, directions, tip_form(fields)) == 0.0
