"""The equations of Su, Li and Wang (2001) derived again with SymPy, and the chain compared with what follows.

From (1) to (8), corrected as the design says, follow Table 1 and (9) to (14). The printed elements that are wrong are
shown to be wrong.
"""

from functools import cache

import numpy as np
import pytest
import sympy as sp

from model.chain import Chain
from model.machine import load_machine, parse_machine, preset
from model.structure import lower_body_array
from model.transforms import exact_error, rotation, small_angle_error

ALPHA, BETA, GAMMA = ANGLES = sp.symbols("alpha beta gamma", real=True)
ORDER = sp.Symbol("epsilon")  # every error is multiplied by it; its first power is the first order
DOF = ("X", "Y", "Z", "A", "B", "C")
MOVED = {"Y": (0, 1, 0), "X": (1, 0, 0), "Z": (0, 0, 1)}  # the seed writes the table's own displacement
ORIGINS = {"Y": sp.symbols("a12 b12 c12"), "X": sp.symbols("a23 b23 c23"), "Z": sp.symbols("a14 b14 c14")}
POSITIONS = dict(zip("XYZ", sp.symbols("x y z"), strict=True))
TOOL = sp.symbols("D_x D_y D_z")
ERRORS = {name: sp.Symbol(name) for axis in "XYZ" for d in DOF for name in (f"E{d}{axis}", f"E{d}0{axis}")}
RNG = np.random.default_rng(4)


def product_of_turns() -> sp.Matrix:
    """Return Rx(α) Ry(β) Rz(γ); SymPy's own matrices turn the frame, ours the body, hence the transposes."""
    return (sp.rot_axis1(ALPHA).T * sp.rot_axis2(BETA).T * sp.rot_axis3(GAMMA).T).applyfunc(sp.expand)


def corrected_rotation() -> sp.Matrix:
    """Return the rotation of (1) and (2) as corrected."""
    s, c, (a, b, g) = sp.sin, sp.cos, ANGLES
    return sp.Matrix(
        [
            [c(b) * c(g), -c(b) * s(g), s(b)],
            [c(a) * s(g) + s(a) * s(b) * c(g), c(a) * c(g) - s(a) * s(b) * s(g), -s(a) * c(b)],
            [s(a) * s(g) - c(a) * s(b) * c(g), s(a) * c(g) + c(a) * s(b) * s(g), c(a) * c(b)],
        ]
    )


def printed_elements(equation: int) -> dict[tuple[int, int], sp.Expr]:
    """Return the wrong elements of (1) or (2) as the paper prints them, by row and column from 0."""
    s, c, (a, b, g) = sp.sin, sp.cos, ANGLES
    wrong = {
        (1, 0): c(b) * s(g) + s(a) * s(b) * c(g),
        (2, 0): s(b) * s(g) - c(a) * s(b) * c(g),
    }
    return wrong | ({(2, 1): s(a) * s(g) + c(a) * s(b) * s(g)} if equation == 1 else {})


def transform(turned: sp.Matrix, offset: tuple[sp.Expr, ...]) -> sp.Matrix:
    return turned.row_join(sp.Matrix(offset)).col_join(sp.Matrix([[0, 0, 0, 1]]))


def error_transform(ending: str, form: str) -> sp.Matrix:
    """Return (2) for the errors `E?<ending>`, or its first order, which is (3), (4) and (5)."""
    values = [ORDER * ERRORS[f"E{d}{ending}"] for d in DOF]
    exact = transform(corrected_rotation().subs(dict(zip(ANGLES, values[3:], strict=True))), tuple(values[:3]))
    return exact if form == "exact" else first_order(exact)


def first_order(expression: sp.Matrix) -> sp.Matrix:
    """Return the value at ε = 0 plus ε times the slope there."""
    return expression.subs(ORDER, 0) + ORDER * expression.diff(ORDER).subs(ORDER, 0)


@cache
def joint(axis: str, form: str) -> sp.ImmutableMatrix:
    """Return (6) for a prismatic joint: HT ΔFT ΔMT, with HT of (1) at angles zero."""
    offset = tuple(a + m * POSITIONS[axis] for a, m in zip(ORIGINS[axis], MOVED[axis], strict=True))
    ideal = transform(corrected_rotation().subs(dict.fromkeys(ANGLES, 0)), offset)
    return sp.ImmutableMatrix(ideal * error_transform(f"0{axis}", form) * error_transform(axis, form))


def programmed_point() -> sp.Matrix:
    """Return P3, where the ideal chain has the tool tip in the workpiece frame: T13^-1 T14 D4 without errors."""
    ideal = {axis: joint(axis, "small-angle").subs(ORDER, 0) for axis in "XYZ"}
    return (ideal["Y"] * ideal["X"]).inv() * ideal["Z"] * sp.Matrix([*TOOL, 1])


@cache
def first_order_error() -> sp.ImmutableMatrix:
    """Return the slope of (8) and (12), E = T12 T23 P3 - T14 D4, in ε; where ε = 0, E = 0. D4 ends in 1, not l."""
    value, slope = (
        {axis: of(joint(axis, "small-angle")).subs(ORDER, 0) for axis in "XYZ"}
        for of in (lambda matrix: matrix, lambda matrix: matrix.diff(ORDER))
    )
    point, tool = programmed_point(), sp.Matrix([*TOOL, 1])
    assert (value["Y"] * value["X"] * point - value["Z"] * tool).applyfunc(sp.expand) == sp.zeros(4, 1)
    turned = slope["Y"] * value["X"] + value["Y"] * slope["X"]
    return sp.ImmutableMatrix(turned * point - slope["Z"] * tool)


def test_table_1_is_the_powers_of_the_lower_body_array() -> None:
    array = lower_body_array(load_machine(preset("seed3")).bodies)
    powers = [list(range(1, 5))]  # L^0(j) = j
    while any(powers[-1]):
        powers.append([array[j - 1] if j else 0 for j in powers[-1]])  # L^n(j) = L(L^(n-1)(j)), L(0) = 0
    assert powers == [[1, 2, 3, 4], [0, 1, 2, 1], [0, 0, 1, 0], [0, 0, 0, 0]]


def test_rotation_of_equations_1_and_2_is_the_corrected_one() -> None:
    product = product_of_turns()
    assert (product - corrected_rotation()).applyfunc(sp.simplify) == sp.zeros(3, 3)
    angles = RNG.uniform(-np.pi, np.pi, 3)
    numbers = np.array(product.subs(dict(zip(ANGLES, angles, strict=True))), dtype=float)
    np.testing.assert_allclose(rotation(*(np.asarray(v) for v in angles)), numbers, rtol=0, atol=1e-15)


@pytest.mark.parametrize("equation", [1, 2])
def test_rotation_as_printed_is_no_rotation(equation: int) -> None:
    """Each printed element differs from the product, and the printed matrix is not orthogonal."""
    printed = corrected_rotation()
    for place, element in printed_elements(equation).items():
        assert sp.simplify(product_of_turns()[place] - element) != 0
        printed[place] = element
    at = dict(zip(ANGLES, (sp.Rational(3, 10), sp.Rational(-7, 10), sp.Rational(11, 10)), strict=True))
    gap = np.array((printed.T * printed).subs(at).evalf() - sp.eye(3), dtype=float)
    assert np.abs(gap).max() > 0.1


def test_equation_3_is_the_first_order_of_equation_2() -> None:
    x, y, z, a, b, g = (ORDER * ERRORS[f"E{d}X"] for d in DOF)
    assert error_transform("X", "small-angle") == sp.Matrix([[1, -g, b, x], [g, 1, -a, y], [-b, a, 1, z], [0, 0, 0, 1]])
    e = RNG.normal(size=6)
    at = {ORDER: 1} | {ERRORS[f"E{d}X"]: v for d, v in zip(DOF, e, strict=True)}
    for form, found in (("exact", exact_error(e[None])), ("small-angle", small_angle_error(e[None]))):
        expected = np.array(error_transform("X", form).subs(at), dtype=float)
        np.testing.assert_allclose(found[0], expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("axis", ["Y", "X", "Z"])
def test_equations_9_to_11(axis: str) -> None:
    """Corrected: Δz, not Δx, in row 3; x in row 1 of (10), no z in its row 3; (11) is T14; a12, not Δa12, in (9)."""
    x, y, z, a, b, g = (ORDER * (ERRORS[f"E{d}{axis}"] + ERRORS[f"E{d}0{axis}"]) for d in DOF)
    u, v, w = (o + m * POSITIONS[axis] for o, m in zip(ORIGINS[axis], MOVED[axis], strict=True))
    expected = sp.Matrix([[1, -g, b, u + x], [g, 1, -a, v + y], [-b, a, 1, w + z], [0, 0, 0, 1]])
    for form in ("small-angle", "exact"):
        found = first_order(sp.Matrix(joint(axis, form)))
        assert (found - expected).applyfunc(sp.expand) == sp.zeros(4, 4)


def test_equations_13_and_14_follow_from_12() -> None:
    """Frames that coincide at the start, Z alone moves and errs: P3 = (s, w, h + z), D4 = (s, w, h)."""
    s, w, h = sp.symbols("s w h")
    at = {symbol: 0 for origin in ORIGINS.values() for symbol in origin}
    at |= {POSITIONS["X"]: 0, POSITIONS["Y"]: 0} | dict(zip(TOOL, (s, w, h), strict=True))
    at |= {symbol: 0 for name, symbol in ERRORS.items() if name[2:] != "Z"}
    found = first_order_error().subs(at).applyfunc(sp.expand)
    assert programmed_point().subs(at) == sp.Matrix([s, w, h + POSITIONS["Z"], 1])
    x, y, z, a, b, g = (ERRORS[f"E{d}Z"] for d in DOF)
    expected = sp.Matrix([w * g - h * b - x, h * a - s * g - y, s * b - w * a - z, 0])
    assert (found - expected).applyfunc(sp.expand) == sp.zeros(4, 1)
    assert found.subs({s: 0, w: 0, h: 0}) == sp.Matrix([-x, -y, -z, 0])


def test_equation_12_holds_36_errors() -> None:
    assert first_order_error().free_symbols & set(ERRORS.values()) == set(ERRORS.values())
    assert len(ERRORS) == 36


def seed_machine() -> tuple[Chain, dict[sp.Symbol, float]]:
    """Return the seed's machine with random origins, and their values."""
    origins = {axis: RNG.uniform(-300, 300, 3) for axis in "XYZ"}
    text = 'name = "seed"\nstructure = "w X Y b Z t"\ncomposition = "seed"\n'
    for axis, origin in origins.items():
        text += f"[axes.{axis}]\nrange = [0.0, 800.0]\norigin_mm = {origin.tolist()}\n"
        text += f"direction = {[float(m) for m in MOVED[axis]]}\n"
    values = {symbol: float(v) for a, o in origins.items() for symbol, v in zip(ORIGINS[a], o, strict=True)}
    return Chain(parse_machine(text)), values


@pytest.mark.parametrize("form", ["small-angle", "exact"])
def test_the_chain_is_equation_8(form: str) -> None:
    """At random origins, positions, tools and errors; for the small-angle form with all its products of errors."""
    chain, at = seed_machine()
    order = [*POSITIONS.values(), *TOOL, *(ERRORS[t.name] for t in chain.machine.terms)]
    joints = [sp.lambdify(order, joint(axis, form).subs(at | {ORDER: 1}), "numpy") for axis in "YXZ"]
    point = sp.lambdify(order, programmed_point().subs(at), "numpy")
    for size in (1e-3, 3e-2):
        q, tool, e = RNG.uniform(0, 800, 3), RNG.uniform(-200, 200, 3), size * RNG.normal(size=36)
        t12, t23, t14 = (np.asarray(matrix(*q, *tool, *e)) for matrix in joints)
        expected = t12 @ t23 @ point(*q, *tool, *e)[:, 0] - t14 @ [*tool, 1.0]
        found = chain.seed_error(q[None], e, tool, form=form)[0]
        np.testing.assert_allclose(found, expected[:3], rtol=0, atol=1e-10)


def test_the_sensitivity_is_the_slope_of_equation_12() -> None:
    """To first order E is minus the deviation, so G = -dE/de, column by column."""
    chain, at = seed_machine()
    jacobian = sp.Matrix(first_order_error()[:3, 0]).jacobian([ERRORS[t.name] for t in chain.machine.terms]).subs(at)
    evaluate = sp.lambdify([*POSITIONS.values(), *TOOL], jacobian, "numpy")
    for _ in range(3):
        q, tool = RNG.uniform(0, 800, 3), RNG.uniform(-200, 200, 3)
        np.testing.assert_allclose(chain.sensitivity(q[None], tool)[0, :3], -evaluate(*q, *tool), rtol=0, atol=1e-10)
