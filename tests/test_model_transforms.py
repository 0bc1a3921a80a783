import numpy as np
import pytest

from model.transforms import (
    apply,
    apply_inverse,
    exact_error,
    rotation,
    rotation_vector,
    skew,
    small_angle_error,
)

RNG = np.random.default_rng(1)


def turn(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def test_rotation_is_the_product_of_turns_about_x_then_y_then_z() -> None:
    a, b, g = 0.3, -0.7, 1.1
    expected = turn(0, a) @ turn(1, b) @ turn(2, g)
    np.testing.assert_allclose(rotation(np.array(a), np.array(b), np.array(g)), expected, atol=1e-15)


def test_corrected_elements_of_equation_2() -> None:
    a, b, g = 0.3, -0.7, 1.1
    s, c = np.sin, np.cos
    matrix = rotation(np.array(a), np.array(b), np.array(g))
    assert matrix[1, 0] == pytest.approx(c(a) * s(g) + s(a) * s(b) * c(g), abs=1e-15)
    assert matrix[2, 0] == pytest.approx(s(a) * s(g) - c(a) * s(b) * c(g), abs=1e-15)
    assert matrix[2, 1] == pytest.approx(s(a) * c(g) + c(a) * s(b) * s(g), abs=1e-15)


def test_small_angle_form_meets_the_exact_one_in_second_order() -> None:
    direction = RNG.normal(size=(1, 6))
    gaps = [
        np.abs(exact_error(scale * direction) - small_angle_error(scale * direction)).max()
        for scale in (1e-2, 1e-3, 1e-4)
    ]
    orders = np.log10(np.array(gaps[:-1]) / np.array(gaps[1:]))
    np.testing.assert_allclose(orders, 2.0, atol=0.05)


def test_batch_is_loop() -> None:
    e = RNG.normal(size=(5, 6))
    for form in (exact_error, small_angle_error):
        np.testing.assert_array_equal(form(e), np.concatenate([form(row[None]) for row in e]))


def test_apply_inverse_undoes_apply_in_both_forms() -> None:
    e, point = 0.1 * RNG.normal(size=(7, 6)), RNG.normal(size=(7, 3))
    for form in (exact_error, small_angle_error):
        np.testing.assert_allclose(apply_inverse(form(e), apply(form(e), point)), point, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.5, 3.0])
def test_rotation_vector_is_axis_times_angle(angle: float) -> None:
    for axis in range(3):
        expected = np.zeros(3)
        expected[axis] = angle
        np.testing.assert_allclose(rotation_vector(turn(axis, angle)[None])[0], expected, rtol=1e-9, atol=1e-18)


def test_skew_is_the_cross_product() -> None:
    a, b = RNG.normal(size=3), RNG.normal(size=3)
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), atol=1e-15)
