"""The ideal chain against LinuxCNC's published five-axis kinematics: xyzac-trt, xyzbc-trt and 5axiskins.

The formulas below are stated in LinuxCNC's documentation and agreed with its running controller to 1e-13 mm. The
two programs differ in what they name and in sign:

- LinuxCNC's workpiece frame keeps the machine's origin; ours sits at the rotary table's centre, at r.
- LinuxCNC controls p = w + L ez, the tip w lifted by the tool length L along the *workpiece's* z; ours is the tip.
- The trunnions' sense s: +1 ("conventional-directions") is ISO 841, the tool's turn relative to the workpiece, and
  so our default for axes on the workpiece side. -1, LinuxCNC's default, is the table's own right-handed turn; here that
  is `direction = [1, 0, 0]` and so on. The head's B of 5axiskins runs against ISO 841, its C with it.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from model.chain import Chain
from model.machine import parse_machine

LINEAR_BELOW = ["X Y b Z", "Y X b Z", "b X Y Z", "Z b Y X", "X Y Z b"]
length = st.floats(-300, 300)
point = st.tuples(length, length, length)


def turn(axis: str, degrees: float) -> np.ndarray:
    """Return Rx, Ry or Rz, right-handed."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"A": (1, 2), "B": (2, 0), "C": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def axis_table(name: str, origin: np.ndarray | None = None, direction: list[float] | None = None) -> str:
    text = f"[axes.{name}]\nrange = [-1000.0, 1000.0]\n"
    text += "" if origin is None else f"origin_mm = {origin.tolist()}\n"
    return text + ("" if direction is None else f"direction = {direction}\n")


def trunnion(tilt: str, linear: str, sense: int, r: np.ndarray, d0: np.ndarray) -> Chain:
    """Return a table C on a tilting axis whose line runs through r + d0, C's through r."""
    along = {"A": [1.0, 0.0, 0.0], "B": [0.0, 1.0, 0.0], "C": [0.0, 0.0, 1.0]}
    turned = {name: None if sense > 0 else direction for name, direction in along.items()}
    text = f'name = "trunnion"\nstructure = "w C {tilt} {linear} t"\n' + "".join(axis_table(a) for a in "XYZ")
    text += axis_table(tilt, r + d0, turned[tilt]) + axis_table("C", -d0, turned["C"])
    return Chain(parse_machine(text))


def trt_forward(
    tilt: str, s: int, q: np.ndarray, a: float, c: float, r: np.ndarray, d0: np.ndarray, tool_length: float
) -> np.ndarray:
    """Return LinuxCNC's pose p of the joints q: p = r + Rz(s c) [d + R(s a) (q - r - d)]."""
    d = d0 + np.array([0.0, 0.0, tool_length])
    return np.asarray(r + turn("C", s * c) @ (d + turn(tilt, s * a) @ (q - r - d)))


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("linear", LINEAR_BELOW)
@pytest.mark.parametrize("tilt", ["A", "B"])
@given(point, st.floats(-120, 120), st.floats(-360, 360), point, st.tuples(length, length), st.floats(0, 300))
@settings(deadline=None, max_examples=10)
def test_trunnion_tables(
    tilt: str,
    linear: str,
    sense: int,
    joints: tuple[float, float, float],
    tilted: float,
    turned: float,
    centre: tuple[float, float, float],
    offset: tuple[float, float],
    tool_length: float,
) -> None:
    q, r = np.array(joints), np.array(centre)
    d0 = np.array([0.0, *offset]) if tilt == "A" else np.array([offset[0], 0.0, offset[1]])
    chain = trunnion(tilt, linear, sense, r, d0)
    tip, orientation = chain.pose(np.array([[*q, tilted, turned]]), None, np.array([0.0, 0.0, -tool_length]))
    p = trt_forward(tilt, sense, q, tilted, turned, r, d0, tool_length)
    np.testing.assert_allclose(tip[0], p - [0.0, 0.0, tool_length] - r, rtol=0, atol=1e-10)
    expected_axis = turn("C", sense * turned) @ turn(tilt, sense * tilted) @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(orientation[0] @ [0.0, 0.0, 1.0], expected_axis, rtol=0, atol=1e-14)
    # Their inverse: q = r + d + R(-s a) [Rz(-s c) (p - r) - d].
    d = d0 + np.array([0.0, 0.0, tool_length])
    back = r + d + turn(tilt, -sense * tilted) @ (turn("C", -sense * turned) @ (p - r) - d)
    np.testing.assert_allclose(back, q, rtol=0, atol=1e-10)


def test_an_offset_of_the_pose_moves_the_joints_as_in_the_running_controller() -> None:
    """LinuxCNC, xyzac-trt at A30 C90: an offset of +12 µm in X of the pose moved Y by 10.3923 µm and Z by 6.0000 µm."""
    chain = trunnion("A", "X Y b Z", -1, np.array([3.0, -7.0, -150.0]), np.array([0.0, 20.0, 10.0]))
    jacobian = chain.jacobian(np.array([[10.0, 20.0, -5.0, 30.0, 90.0]]))[0, :3, :3]
    np.testing.assert_allclose(np.linalg.solve(jacobian, [12.0, 0.0, 0.0]), [0.0, 10.3923, 6.0], rtol=0, atol=5e-5)


@given(point, st.floats(-120, 120), st.floats(-360, 360), st.floats(50, 400), st.floats(-100, 100))
@settings(deadline=None, max_examples=60)
def test_tilting_head_with_a_slide_along_the_tool(
    joints: tuple[float, float, float], b: float, c: float, pivot: float, slide: float
) -> None:
    """5axiskins: p = q + (0, 0, P) + (P + W) (sin b cos c, sin b sin c, -cos b)."""
    text = 'name = "head"\nstructure = "w b X Y Z C B W t"\n' + "".join(axis_table(a) for a in "XYZ")
    text += axis_table("C", np.array([0.0, 0.0, pivot])) + axis_table("B", None, [0.0, -1.0, 0.0])
    text += axis_table("W", None, [0.0, 0.0, -1.0]) + f"[tool]\noffset_mm = [0.0, 0.0, {-pivot}]\n"
    chain = Chain(parse_machine(text))
    assert chain.machine.axis_names == ("X", "Y", "Z", "W", "B", "C")
    tip, orientation = chain.pose(np.array([[*joints, slide, b, c]]))
    sb, cb, sc, cc = (f(np.radians(v)) for v in (b, c) for f in (np.sin, np.cos))
    expected = np.array(joints) + [0.0, 0.0, pivot] + (pivot + slide) * np.array([sb * cc, sb * sc, -cb])
    np.testing.assert_allclose(tip[0], expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(orientation[0] @ [0.0, 0.0, 1.0], [-sb * cc, -sb * sc, cb], rtol=0, atol=1e-14)
