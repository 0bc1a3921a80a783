"""Equations (9) to (14) of Su, Li and Wang (2001), with the misprints corrected as DESIGN.md lists them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from model.chain import Chain
from model.machine import load_machine, preset

CHAIN = Chain(load_machine(preset("seed3")))
INDEX = CHAIN.machine.term_index
length = st.floats(-500, 500)
error = st.floats(-1e-3, 1e-3)


def errors(**values: float) -> np.ndarray:
    e = np.zeros(len(INDEX))
    for name, value in values.items():
        e[INDEX[name]] = value
    return e


def paper_matrix(e: np.ndarray, axis: str, at: np.ndarray) -> np.ndarray:
    """Equations (9), (10), (11): sums of motion and location error beside the ideal displacement `at`."""
    x, y, z, alpha, beta, gamma = (
        e[INDEX[f"E{d}{axis}"]] + e[INDEX[f"E{d}0{axis}"]] for d in ("X", "Y", "Z", "A", "B", "C")
    )
    return np.array(
        [
            [1.0, -gamma, beta, at[0] + x],
            [gamma, 1.0, -alpha, at[1] + y],
            [-beta, alpha, 1.0, at[2] + z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


@given(st.integers(0, 2**32 - 1))
def test_equation_12_with_the_matrices_9_to_11(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, tool = rng.uniform(0, 500, 3), rng.uniform(-200, 200, 3)
    gaps = []
    direction = rng.normal(size=len(INDEX))
    for scale in (1e-4, 1e-5):
        e = scale * direction
        t12 = paper_matrix(e, "Y", np.array([0.0, q[1], 0.0]))
        t23 = paper_matrix(e, "X", np.array([q[0], 0.0, 0.0]))
        t14 = paper_matrix(e, "Z", np.array([0.0, 0.0, q[2]]))
        p = np.append(CHAIN.tip(q[None], None, tool)[0], 1.0)
        expected = t12 @ t23 @ p - t14 @ np.append(tool, 1.0)
        gaps.append(np.abs(CHAIN.seed_error(q[None], e, tool)[0] - expected[:3]).max())
        first_order = scale * 1e3
        assert gaps[-1] < 1e-1 * first_order  # the neglected products of two errors
    assert gaps[1] < gaps[0] / 50


@given(length, length, length, st.floats(0, 500), error, error, error, error, error, error)
def test_equation_13_vertical_line_with_the_errors_of_z(
    s: float, w: float, h: float, z: float, dx: float, dy: float, dz: float, da: float, db: float, dc: float
) -> None:
    tool = np.array([s, w, h])
    q = np.array([[0.0, 0.0, z]])
    np.testing.assert_allclose(CHAIN.tip(q, None, tool)[0], [s, w, h + z], atol=1e-12)
    e = errors(EXZ=dx, EYZ=dy, EZZ=dz, EAZ=da, EBZ=db, ECZ=dc)
    expected = [w * dc - h * db - dx, h * da - s * dc - dy, s * db - w * da - dz]
    np.testing.assert_allclose(CHAIN.seed_error(q, e, tool)[0], expected, atol=1e-12)


@given(st.floats(0, 500), error, error, error, error)
def test_equation_14_without_levers(z: float, dx: float, dy: float, dz: float, turned: float) -> None:
    e = errors(EXZ=dx, EYZ=dy, EZZ=dz, EAZ=turned, EBZ=turned, ECZ=turned)
    found = CHAIN.seed_error(np.array([[0.0, 0.0, z]]), e, np.zeros(3))[0]
    np.testing.assert_allclose(found, [-dx, -dy, -dz], atol=1e-12)


def test_error_vector_is_minus_the_deviation_to_first_order() -> None:
    rng = np.random.default_rng(3)
    q, e = rng.uniform(0, 500, (5, 3)), 1e-6 * rng.normal(size=len(INDEX))
    assert CHAIN.seed_error(q, e) == pytest.approx(-CHAIN.deviation(q, e).position_mm, abs=1e-8)
