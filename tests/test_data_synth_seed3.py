"""The seed's machine: what section 3.3 of Su, Li and Wang (2001) reports of its 36 terms."""

import numpy as np
import pytest

from data_synth.machines import open_shop
from data_synth.materials import STEEL
from data_synth.run import simulate
from data_synth.tip import tip_deviation
from model.machine import parse_machine
from model.term_classes import squareness_terms

SHOP = open_shop("seed3")
NODES = SHOP.design.network.nodes
SQUARE = set(squareness_terms(SHOP.machine))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.fixture(scope="module", params=["shop", "steps", "axes"])
def drift(request):
    """Return how each term moves over a shift, (t, positions) each."""
    terms = simulate(SHOP, "run", request.param, (3, 1), 10.0).terms
    heads, values = terms.columns(SHOP.machine)
    moved = values - values[0]
    return {term.name: moved[:, [name == term.name for name, _ in heads]] for term in SHOP.machine.terms}


def sizes(drift, kind, angular):
    """Return the rms of the terms of one kind, motion or location, squareness left out."""
    terms = (t for t in SHOP.machine.terms if t.kind == kind and t.angular == angular and t.name not in SQUARE)
    return rms(np.concatenate([drift[t.name].ravel() for t in terms]))


@pytest.mark.parametrize("angular", [False, True])
def test_the_fifteen_secondary_terms_lie_two_to_three_orders_below_the_motion_terms(drift, angular):
    ratio = sizes(drift, "location", angular) / sizes(drift, "motion", angular)
    assert 0.5e-3 < ratio < 1e-2


def test_the_three_squareness_terms_are_as_large_as_the_motion_terms(drift):
    assert sorted(SQUARE) == ["EA0Z", "EB0Z", "EC0X"]
    ratio = rms(np.concatenate([drift[name].ravel() for name in SQUARE])) / sizes(drift, "motion", True)
    assert 0.3 < ratio < 10.0


def test_motion_errors_of_z_depend_on_time_and_position(drift):
    for direction in "XYZABC":
        values = drift[f"E{direction}Z"]
        assert np.ptp(values, axis=0).max() > 0.1  # over time [µm, µrad]
        assert np.ptp(values, axis=1).max() > 0.1  # over position


def test_drift_over_a_shift_is_some_ten_micrometres(drift):
    assert 3.0 < np.abs(drift["EZZ"]).max() < 100.0


def test_a_warm_spindle_lowers_the_head_wherever_it_stands():
    rise = np.array([[20.0 if name.startswith("spindle") else 0.0 for name in NODES]])
    got = SHOP.fields.evaluate(rise, np.zeros(1))
    assert "T" not in got.location
    np.testing.assert_allclose(got.motion["Z"][0, 2], -20e3 * 180.0 * STEEL.expansion_per_K)


def test_both_compositions_put_the_tip_in_the_same_place():
    """Only the share of location and motion differs."""
    iso = parse_machine(SHOP.machine.source.replace('composition = "seed"', 'composition = "motion-last"'))
    rise = np.random.default_rng(2).normal(3.0, 3.0, (4, len(NODES)))
    tips, squareness = [], []
    for machine in (SHOP.machine, iso):
        fields = SHOP.design.structure.fields(machine, SHOP.design.network.index(), 33)
        terms = fields.evaluate(rise, np.zeros(4))
        tips.append(tip_deviation(machine, terms))
        squareness.append(np.polyfit(terms.positions["Z"], terms.motion["Z"][:, 0].T, 1)[0])
    np.testing.assert_allclose(tips[0], tips[1], atol=1e-9)
    assert np.abs(squareness[0]).min() > 1e-4  # in the seed's composition Z leans in its straightness
    np.testing.assert_allclose(squareness[1], 0.0, atol=1e-12)


def test_symmetric_warmth_leaves_symmetric_motion_terms_zero():
    warm = {"column_upper": 4.0, "bed_front": -2.0, "head_front": 7.0, "spindle": 20.0, "screw": 5.0}
    rise = np.array([[sum(k for start, k in warm.items() if name.startswith(start)) for name in NODES]])
    got = SHOP.fields.evaluate(rise, np.zeros(1))
    for axis in "YZ":
        np.testing.assert_allclose(got.motion[axis][0, [0, 4, 5]], 0.0, atol=1e-9)
