import numpy as np
import pytest
from machines import five_axis_text, machine_text

from model.fields import GRID_POINTS, Fields
from model.machine import parse_machine

MACHINE = parse_machine(machine_text())
FIELDS = Fields(MACHINE, ("EXX", "EBY", "EC0Y", "EZ0T"), 3)
RNG = np.random.default_rng(4)


def test_a_motion_term_is_its_chebyshev_series_and_a_location_term_its_coefficient() -> None:
    assert FIELDS.size == 4 + 4 + 1 + 1
    coefficients = np.zeros((1, FIELDS.size))
    coefficients[0, FIELDS.slices()["EXX"]] = [1.0, 2.0, 3.0, 4.0]
    coefficients[0, FIELDS.slices()["EC0Y"]] = 5.0
    e = FIELDS.evaluate(coefficients, np.array([[600.0, 0.0, 0.0]]))[0]  # ξ = 0.5
    expected = 1.0 + 2.0 * 0.5 + 3.0 * (2 * 0.25 - 1) + 4.0 * (4 * 0.125 - 1.5)
    assert e[MACHINE.term_index["EXX"]] == pytest.approx(expected * 1e-3)
    assert e[MACHINE.term_index["EC0Y"]] == pytest.approx(5e-6)
    assert np.count_nonzero(e) == 2


def test_the_tabulated_map_is_the_series_at_its_knots_and_close_in_between() -> None:
    coefficients = RNG.uniform(-100, 100, FIELDS.size)
    table = FIELDS.tabulate(coefficients)
    for name, axis in MACHINE.axes.items():
        column = MACHINE.axis_names.index(name)
        for n, tolerance in ((GRID_POINTS, 1e-12), (1001, 0.1e-3)):
            q = np.zeros((n, 3))
            q[:, column] = np.linspace(axis.low, axis.high, n)
            direct = FIELDS.evaluate(np.tile(coefficients, (n, 1)), q)
            np.testing.assert_allclose(table.evaluate(q), direct, atol=tolerance)


def test_a_cubic_of_100_um_stays_within_50_nm_of_its_table() -> None:
    coefficients = np.zeros(FIELDS.size)
    coefficients[FIELDS.slices()["EXX"]] = [0.0, 0.0, 0.0, 100.0]
    q = np.zeros((20001, 3))
    q[:, 0] = np.linspace(0.0, 800.0, len(q))
    direct = FIELDS.evaluate(np.tile(coefficients, (len(q), 1)), q)
    assert np.abs(FIELDS.tabulate(coefficients).evaluate(q) - direct).max() <= 0.05e-3


def test_halving_the_grid_quarters_the_gap() -> None:
    """Linear interpolation is of second order."""
    series = np.array([0.0, 0.0, 0.0, 1.0])
    gaps = []
    for n in (GRID_POINTS, 2 * GRID_POINTS - 1):
        knots = np.linspace(0.0, 800.0, n)
        fine = np.linspace(0.0, 800.0, 5001)
        direct = FIELDS.basis("EXX", fine) @ series
        gaps.append(np.abs(np.interp(fine, knots, FIELDS.basis("EXX", knots) @ series) - direct).max())
    assert np.log2(gaps[0] / gaps[1]) == pytest.approx(2.0, abs=0.1)


TABLE = parse_machine(five_axis_text("w C A Y X b Z t"))


def test_what_comes_once_and_twice_a_turn_is_in_the_series_of_a_table() -> None:
    """C reaches 720 degrees, of which no short polynomial follows two turns; any phase, and the same a turn on."""
    fields = Fields(TABLE, ("EZC", "EAC", "EXX", "EX0C"), 3)
    assert fields.widths() == [5, 5, 4, 1]
    p = np.linspace(-360.0, 360.0, 200)
    for phase in (0.3, 2.0):
        wanted = 4.0 + 7.0 * np.cos(np.deg2rad(p) + phase) - 2.0 * np.sin(2 * np.deg2rad(p) + phase)
        basis = fields.basis("EZC", p)
        found = np.linalg.lstsq(basis, wanted)[0]
        np.testing.assert_allclose(basis @ found, wanted, atol=1e-12)
    on = p[p > 0.0]
    np.testing.assert_allclose(fields.basis("EZC", on - 360.0), fields.basis("EZC", on), atol=1e-12)


def test_the_table_of_harmonics_stays_close_between_its_knots() -> None:
    fields = Fields(TABLE, ("EZC",), 4)
    q = np.zeros((5001, 5))
    q[:, TABLE.axis_names.index("C")] = np.linspace(-360.0, 360.0, len(q))
    for k in range(fields.size):
        coefficients = np.zeros(fields.size)
        coefficients[k] = 100.0
        direct = fields.evaluate(np.tile(coefficients, (len(q), 1)), q)
        assert np.abs(fields.tabulate(coefficients).evaluate(q) - direct).max() <= 0.07e-3
