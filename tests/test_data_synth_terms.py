"""Every error term of every machine, as a function of temperature and of position."""

import numpy as np
import pytest

from data_synth.machines import DESIGNS, open_shop

FIELDS = 3.0 * np.random.default_rng(3).normal(size=(4, 400))


@pytest.fixture(scope="module", params=[*DESIGNS, "trunnion5~1"])
def found(request):
    """Return a machine and the largest of each term's values and of their change over position [µm, µrad]."""
    shop = open_shop(request.param)
    rise = FIELDS[:, : len(shop.design.network.nodes)]
    heads, values = shop.fields.evaluate(rise, np.zeros(len(rise))).columns(shop.machine)
    names = np.array([name for name, _ in heads])
    by_term = {name: values[:, names == name] for name in dict.fromkeys(names)}
    return shop.machine, by_term


def test_every_term_moves_under_some_temperature(found):
    machine, by_term = found
    assert list(by_term) == [term.name for term in machine.terms]
    assert {name for name, values in by_term.items() if np.abs(values).max() < 1e-3} == set()


def test_every_motion_term_changes_with_position(found):
    machine, by_term = found
    moving = [term.name for term in machine.terms if term.kind == "motion"]
    still = {name for name in moving if np.ptp(by_term[name], axis=1).max() < 1e-3}
    assert still == set()
