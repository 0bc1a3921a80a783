"""Machines with rotary axes, trees and several tools: the chain's laws and its compensation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from machines import FIVE_AXIS, five_axis_text, machine_text
from test_model_compensation import random_errors

from model.chain import Chain
from model.compensation import SINGULAR, compensate
from model.error_map import ErrorMap
from model.exceptions import MachineError
from model.machine import parse_machine

CHAINS = [Chain(parse_machine(five_axis_text(s, c))) for s in FIVE_AXIS for c in ("motion-last", "seed")]


def poses(chain: Chain, n: int, rng: np.random.Generator) -> np.ndarray:
    axes = [chain.machine.axes[a] for a in chain.machine.axis_names]
    return rng.uniform([a.low for a in axes], [a.high for a in axes], (n, len(axes)))


@pytest.mark.parametrize("chain", CHAINS)
def test_jacobian_and_sensitivity_are_derivatives(chain: Chain) -> None:
    rng = np.random.default_rng(1)
    q = poses(chain, 3, rng)
    tip, turned = chain.pose(q)
    jacobian, step = chain.jacobian(q), 1e-5
    for column in range(q.shape[1]):
        moved = q.copy()
        moved[:, column] += step
        found_tip, found = chain.pose(moved)
        rotated = found @ np.swapaxes(turned, 1, 2)
        spin = np.stack([rotated[:, 2, 1], rotated[:, 0, 2], rotated[:, 1, 0]], axis=1)
        np.testing.assert_allclose((found_tip - tip) / step, jacobian[:, :3, column], atol=1e-4)
        np.testing.assert_allclose(spin / step, jacobian[:, 3:, column], atol=1e-6)
    sensitivity = chain.sensitivity(q)
    for k in range(len(chain.machine.terms)):
        e = np.zeros(len(chain.machine.terms))
        e[k] = 1e-6
        plus, minus = chain.deviation(q, e), chain.deviation(q, -e)
        slope = np.concatenate(
            [plus.position_mm - minus.position_mm, plus.orientation_rad - minus.orientation_rad], axis=1
        )
        np.testing.assert_allclose(slope / 2e-6, sensitivity[:, :, k], atol=5e-5)


@given(st.sampled_from(CHAINS), st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=60)
def test_tip_and_tool_axis_come_back_wherever_the_pose_is_not_singular(chain: Chain, seed: int) -> None:
    """For terms of up to 1 mm and 1 mrad: 1 nm always, 1 nrad away from singular poses."""
    rng = np.random.default_rng(seed)
    errors = random_errors(chain.machine, rng)
    q = poses(chain, 16, rng)
    found = compensate(chain, q, errors)
    tip, turned = chain.pose(found.corrected, errors.evaluate(found.corrected))
    wanted_tip, wanted = chain.pose(q)
    np.testing.assert_allclose(tip, wanted_tip, atol=1e-6)
    assert (found.residual_mm <= 1e-6).all()
    along = np.array(chain.machine.tool.direction)
    tilt = np.linalg.norm(np.cross(turned @ along, wanted @ along), axis=1)
    np.testing.assert_allclose(tilt, np.sin(found.tilt_rad), atol=1e-12)
    assert (tilt[_steepness(chain, found.corrected) > 1.5 * SINGULAR] <= 1e-9).all()


def _steepness(chain: Chain, q: np.ndarray) -> np.ndarray:
    """Return how much the tool axis turns at least per angle of the rotary axes."""
    axis = chain.pose(q)[1] @ np.array(chain.machine.tool.direction)
    rotary = [i for i, a in enumerate(chain.machine.axis_names) if chain.machine.axes[a].rotary]
    spin = np.degrees(chain.jacobian(q)[:, 3:, rotary])
    spin = spin - axis[..., None] * (axis[:, None, :] @ spin)
    return np.linalg.svd(spin, compute_uv=False).min(axis=1)


def test_near_a_pole_the_table_does_not_jump_and_the_remainder_is_told() -> None:
    """The pole of a trunnion: C turns about the tool, so no C can undo a tilt about Y."""
    chain = Chain(parse_machine(five_axis_text("w C A Y X b Z t")))
    errors = ErrorMap.from_rows(chain.machine, [("EB0T", None, 1000.0)])
    a = chain.machine.axis_names.index("A")
    q = np.zeros((401, 5))
    q[:, a] = np.linspace(-5.0, 5.0, 401)
    found = compensate(chain, q, errors)
    moved = np.abs(found.corrected - q)[:, 3:]
    assert moved.max() <= np.degrees(1.1e-3 / SINGULAR)
    assert (found.residual_mm <= 1e-6).all()
    assert found.tilt_rad[200] == pytest.approx(1e-3, rel=1e-3)
    assert found.tilt_rad[[0, -1]].max() <= 1e-9
    jumps = np.abs(np.diff(found.corrected - q, axis=0))[:, 3:]
    assert jumps.max() < 1.0  # a step of 0.025 degree in A; without fading C would swing by 180 degrees


@pytest.mark.parametrize("chain", CHAINS[:4])
def test_close_to_a_pole_knots_of_a_table_do_not_keep_the_tip_from_its_place(chain: Chain) -> None:
    """Random tables with many knots; poses within two degrees of where the first rotary axis loses its effect."""
    rng = np.random.default_rng(12)
    machine = chain.machine
    rows: list[tuple[str, float | None, float]] = []
    for term in machine.terms:
        if term.kind == "motion":
            axis = machine.axes[term.axis]
            knots = np.linspace(axis.low, axis.high, 41)
            rows += [(term.name, float(p), float(rng.uniform(-300, 300))) for p in knots]
    errors = ErrorMap.from_rows(machine, rows)
    q = poses(chain, 200, rng)
    rotary = [i for i, a in enumerate(machine.axis_names) if machine.axes[a].rotary]
    q[:, rotary[0]] = np.linspace(-2.0, 2.0, 200)
    assert compensate(chain, q, errors).residual_mm.max() <= 1e-6


def test_kept_axes_stay_and_the_tilt_remains() -> None:
    rng = np.random.default_rng(5)
    chain = CHAINS[0]
    errors = random_errors(chain.machine, rng)
    q = poses(chain, 10, rng)
    found = compensate(chain, q, errors, keep=("A", "C"))
    np.testing.assert_array_equal(found.corrected[:, 3:], q[:, 3:])
    assert (found.residual_mm <= 1e-6).all()
    assert found.tilt_rad.max() > 1e-4
    with pytest.raises(MachineError, match="unknown axis 'B' to keep; known are A, C, X, Y, Z"):
        compensate(chain, q, errors, keep=("B",))


def test_a_machine_that_cannot_reach_a_direction_says_what_is_left() -> None:
    chain = Chain(parse_machine(machine_text("w Y b X Z t")))
    errors = ErrorMap.from_rows(chain.machine, [("EYX", 0.0, 10.0)])
    found = compensate(chain, np.array([[1.0, 2.0, 3.0]]), errors, keep=("Y",))
    assert found.residual_mm[0] == pytest.approx(0.010, abs=1e-6)


def test_parallel_linear_axes_share_the_correction() -> None:
    text = machine_text("w Y b X Z W t").replace("[tool]", "[axes.W]\nrange = [0.0, 100.0]\n[tool]")
    with pytest.raises(
        MachineError, match="key 'structure' in .*: bodies 'workpiece' and 'W' would both have the .* EX0W"
    ):
        parse_machine(text)
    chain = Chain(parse_machine(text.replace("[workpiece]\nerrors = true", "")))
    errors = ErrorMap.from_rows(chain.machine, [("EZ0T", None, 10.0)])
    found = compensate(chain, np.array([[1.0, 2.0, 3.0, 4.0]]), errors)
    np.testing.assert_allclose(found.corrected[0, 2:] - [3.0, 4.0], [-0.005, -0.005], atol=1e-9)


TWINS = """
name = "twins"
[[bodies]]
name = "bed"
[[bodies]]
name = "saddle"
lower = "bed"
axis = "X"
[[bodies]]
name = "workpiece"
lower = "saddle"
[[bodies]]
name = "bridge"
lower = "bed"
axis = "Y"
[[bodies]]
name = "left"
lower = "bridge"
axis = "Z"
[[bodies]]
name = "right"
lower = "bridge"
axis = "W"
[[bodies]]
name = "tool1"
lower = "left"
[[bodies]]
name = "tool2"
lower = "right"
[tool]
errors = true
""" + "".join(f"[axes.{a}]\nrange = [0.0, 300.0]\n" for a in "XYZW")


def test_twin_spindles_each_feel_their_own_axis() -> None:
    machine = parse_machine(TWINS)
    assert [t.name for t in machine.terms if "0T" in t.name][::6] == ["EX0T1", "EX0T2"]
    with pytest.raises(MachineError, match="machine 'twins' has the tools tool1, tool2; name one"):
        Chain(machine)
    with pytest.raises(MachineError, match="unknown tool 'tool3' of machine 'twins'; did you mean 'tool"):
        Chain(machine, "tool3")
    q = np.full((1, 4), 50.0)
    for tool, mine, other in (("tool1", "EZZ", "EZW"), ("tool2", "EZW", "EZZ")):
        chain = Chain(machine, tool)
        for name, expected in ((mine, 0.01), (other, 0.0)):
            e = np.zeros(len(machine.terms))
            e[machine.term_index[name]] = 0.01
            assert chain.deviation(q, e).position_mm[0, 2] == pytest.approx(expected, abs=1e-12)


def test_what_carries_both_workpiece_and_tool_moves_neither_against_the_other() -> None:
    text = TWINS.replace('name = "saddle"\nlower = "bed"', 'name = "saddle"\nlower = "bridge"')
    machine = parse_machine(text)
    chain = Chain(machine, "tool1")
    y = machine.axis_names.index("Y")
    q = np.full((2, 4), 50.0)
    q[1, y] = 100.0
    np.testing.assert_allclose(*chain.tip(q), atol=1e-12)
    assert not chain.sensitivity(q)[:, :, machine.motion_columns["Y"]].any()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('lower = "bed"\naxis = "X"', 'lower = "left"\naxis = "X"', None),
        ('name = "right"', 'name = "left"', "key 'bodies' in .*: body 'left' stands twice in the table of bodies"),
        ('axis = "W"', 'axis = "Z"', "key 'bodies' in .*: axis 'Z' moves two bodies; each axis moves one body"),
        ('axis = "W"', 'axis = "Q"', "key 'bodies' in .*: body 'right' has the unknown axis 'Q'"),
        ('lower = "bed"\naxis = "X"', 'axis = "X"', "key 'bodies' in .* must have one bed, .* got bed, saddle"),
        ('name = "bed"', 'name = "bed"\nlower = "right"', "key 'bodies' in .* must have one bed, .* got none"),
        (
            'lower = "bed"\naxis = "Y"',
            'lower = "right"\naxis = "Y"',
            "key 'bodies' in .*: the lower bodies .* circle",
        ),
        ('lower = "right"', 'lower = "rihgt"', "key 'bodies' in .*: body 'tool2' has the unknown lower body 'rihgt'"),
        ('name = "workpiece"', 'name = "part"', "key 'bodies' in .* must have a leaf called 'workpiece', got none"),
        ('lower = "right"', 'lower = "tool1"', "key 'bodies' in .*: body 'tool1' must be a leaf, but carries another"),
        ('name = "bed"', 'name = "bed"\naxis = "X"', "key 'bodies' in .*: .*"),
        ("[[bodies]]", 'structure = "w X b t"\n[[bodies]]', "machine .* must have either 'structure' or .*, got both"),
    ],
)
def test_wrong_trees_get_one_sentence(old: str, new: str, message: str | None) -> None:
    assert old in TWINS
    text = TWINS.replace(old, new, 1)
    if message is None:
        parse_machine(text)
        return
    with pytest.raises(MachineError, match=message) as caught:
        parse_machine(text)
    assert "\n" not in str(caught.value)


def test_no_tool_and_no_structure() -> None:
    with pytest.raises(MachineError, match="key 'bodies' in .* must have a leaf whose name .*, got none"):
        parse_machine(TWINS.replace('"tool1"', '"left1"').replace('"tool2"', '"right2"'))
    with pytest.raises(MachineError, match=r"machine description must have either 'structure' or .*, got neither"):
        parse_machine('name = "x"\n[axes.X]\nrange = [0.0, 1.0]')


@pytest.mark.parametrize(
    ("spelling", "plain"),
    [
        ("V [w C2' B' X' b Y Z (C1) t]", "w C B X b Y Z t"),
        ("wC'B'X'bYZ(C)t", "w C B X b Y Z t"),
        ("CBXFYZ", "w C B X b Y Z t"),  # Renishaw: F is the frame
    ],
)
def test_spellings_of_structures(spelling: str, plain: str) -> None:
    def layout(structure: str) -> object:
        return parse_machine(five_axis_text("w C B X b Y Z t").replace("w C B X b Y Z t", structure)).layout

    assert layout(spelling) == layout(plain)


def test_isg_spelling_counts_the_axes_on_the_workpiece_side() -> None:
    plain = five_axis_text("w C B X b Y Z t")
    isg = plain.replace('"w C B X b Y Z t"', '"CBXYZ"\nworkpiece_axes = 3')
    assert parse_machine(isg).layout == parse_machine(plain).layout
    with pytest.raises(MachineError, match="key 'structure' in .*: workpiece_axes must be a part of the 5 axes"):
        parse_machine(isg.replace("workpiece_axes = 3", "workpiece_axes = 6"))
