import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from machines import machine_text

from model.error_map import ErrorMap
from model.exceptions import DataError
from model.machine import parse_machine

MACHINE = parse_machine(machine_text())
finite = st.floats(-1000, 1000, allow_subnormal=False)


@st.composite
def maps(draw: st.DrawFn) -> ErrorMap:
    rows: list[tuple[str, float | None, float]] = []
    for name in ("EXX", "EYX", "ECZ"):
        axis = MACHINE.axes[name[-1]]
        positions = draw(st.lists(st.floats(axis.low, axis.high, width=16), min_size=1, max_size=5, unique=True))
        rows += [(name, p, draw(finite)) for p in positions]
    rows.append(("EC0Y", None, draw(finite)))
    return ErrorMap.from_rows(MACHINE, rows)


q_strategy = st.lists(
    st.tuples(st.floats(-100, 900), st.floats(-300, 300), st.floats(-50, 600)), min_size=1, max_size=5
).map(np.array)


def test_linear_between_rows_and_constant_beyond() -> None:
    table = ErrorMap.from_rows(MACHINE, [("EXX", 100.0, 10.0), ("EXX", 300.0, 30.0)])
    q = np.array([[x, 0.0, 0.0] for x in (0.0, 100.0, 150.0, 300.0, 800.0)])
    found = table.evaluate(q)[:, MACHINE.term_index["EXX"]]
    np.testing.assert_allclose(found, [0.010, 0.010, 0.015, 0.030, 0.030], atol=1e-15)


@given(maps(), maps(), q_strategy)
def test_the_sum_of_maps_is_the_sum_of_their_values(a: ErrorMap, b: ErrorMap, q: np.ndarray) -> None:
    np.testing.assert_allclose((a + b).evaluate(q), a.evaluate(q) + b.evaluate(q), atol=1e-9)
    np.testing.assert_allclose((a - b).evaluate(q), a.evaluate(q) - b.evaluate(q), atol=1e-9)
    np.testing.assert_allclose(a.scaled(-2.0).evaluate(q), -2.0 * a.evaluate(q), atol=1e-9)


@given(maps(), q_strategy)
def test_rows_are_the_inverse_of_from_rows(a: ErrorMap, q: np.ndarray) -> None:
    np.testing.assert_allclose(ErrorMap.from_rows(MACHINE, a.rows()).evaluate(q), a.evaluate(q), atol=1e-12)


def test_slopes_are_the_derivative_inside_a_segment_and_zero_beyond() -> None:
    table = ErrorMap.from_rows(MACHINE, [("EXX", 100.0, 10.0), ("EXX", 300.0, 30.0), ("EBX", 100.0, 5.0)])
    q = np.array([[x, 0.0, 0.0] for x in (50.0, 200.0, 400.0)])
    step = np.array([1e-3, 0.0, 0.0])
    expected = (table.evaluate(q + step) - table.evaluate(q - step)) / 2e-3
    np.testing.assert_allclose(table.slopes(q), expected, atol=1e-12)


def test_terms_without_rows_are_zero() -> None:
    assert not ErrorMap.zero(MACHINE).evaluate(np.zeros((2, 3))).any()


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([("EQX", 0.0, 1.0)], "table, row 1: unknown error term 'EQX' for machine 'test'"),
        ([("EXX", 0.0, 1.0), ("EXX", 0.0, 2.0)], "table, row 2: EXX has position 0 twice; keep one row"),
        ([("EXX", None, 1.0)], "table, row 1: EXX is a motion term; give the position on axis X"),
        ([("EC0Y", 5.0, 1.0)], "table, row 1: EC0Y is a location term; leave its position empty, got 5"),
        ([("EC0Y", None, 1.0), ("C0Y", None, 1.0)], "table, row 2: EC0Y stands twice; keep one row"),
        ([("EXX", 0.0, float("nan"))], "table, row 1: value of EXX must be finite, got nan"),
        ([("EXX", float("inf"), 0.0)], "table, row 1: EXX is a motion term; give the position"),
    ],
)
def test_a_wrong_table_gets_one_sentence(rows: list[tuple[str, float | None, float]], message: str) -> None:
    with pytest.raises(DataError, match=message):
        ErrorMap.from_rows(MACHINE, rows, "table")
