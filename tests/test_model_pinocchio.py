"""The chain against pinocchio, an independent engine for rigid-body trees.

The same random tree is written twice: as a machine description, and as joints and fixed frames of pinocchio, in which
every error is a fixed frame before or behind its joint. Nothing of `model` is used on pinocchio's side.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from hypothesis import given, settings
from hypothesis import strategies as st

from model.chain import Chain
from model.machine import Machine, parse_machine

LINEAR, ROTARY = "XYZUVW", "ABC"
POSES = 2


@dataclass(frozen=True)
class Row:
    """A body as both sides write it; `axis` None is a fixed one."""

    name: str
    lower: str | None
    axis: str | None = None
    origin: tuple[float, ...] = (0.0, 0.0, 0.0)
    direction: tuple[float, ...] = (0.0, 0.0, 1.0)


def fixture_errors(axes: Iterable[str | None]) -> str:
    """Return the key that gives the fixture error terms; beside an axis W their names would be taken."""
    return "" if "W" in axes else "[workpiece]\nerrors = true\n"


def described(rows: list[Row], composition: str) -> Machine:
    text = f'name = "random"\ncomposition = "{composition}"\n'
    text += "[tool]\nerrors = true\n" + fixture_errors(row.axis for row in rows)
    for row in rows:
        text += f'[[bodies]]\nname = "{row.name}"\n'
        text += f'lower = "{row.lower}"\n' if row.lower else ""
        text += f'axis = "{row.axis}"\n' if row.axis else ""
    for row in rows:
        if row.axis:
            text += f"[axes.{row.axis}]\nrange = [-400.0, 400.0]\n"
            text += f"origin_mm = {list(row.origin)}\ndirection = {list(row.direction)}\n"
    return parse_machine(text)


def suffix(row: Row) -> str | None:
    """Return what the row's location terms end in."""
    if row.name == "workpiece":
        return "W"
    return "T" + row.name.removeprefix("tool") if row.name.startswith("tool") else row.axis


def error_frame(machine: Machine, e: np.ndarray, ending: str) -> pin.SE3:
    """Return the six terms `E?<ending>` as a fixed frame, Rx Ry Rz behind a displacement."""
    x, y, z, alpha, beta, gamma = (float(e[machine.term_index[f"E{d}{ending}"]]) for d in "XYZABC")
    turned = pin.utils.rotate("x", alpha) @ pin.utils.rotate("y", beta) @ pin.utils.rotate("z", gamma)
    return pin.SE3(turned, np.array([x, y, z]))


def by_pinocchio(
    rows: list[Row], machine: Machine, q: np.ndarray, e: np.ndarray | None, tool: str, tool_mm: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the tip and `work_R_tool` at one pose."""
    zero = np.zeros(len(machine.terms)) if e is None else e
    tree = pin.Model()
    joint = {}  # the joint that carries each body
    behind = {}  # the body's frame as that joint sees it
    for row in rows:
        if row.lower is None:
            joint[row.name], behind[row.name] = 0, pin.SE3.Identity()
            continue
        parent, placement = joint[row.lower], behind[row.lower]
        ending = suffix(row)
        if row.name == "workpiece" and "W" in machine.axes:
            ending = None
        location = error_frame(machine, zero, f"0{ending}") if ending else pin.SE3.Identity()
        if row.axis is None:
            joint[row.name], behind[row.name] = parent, placement * location
            continue
        motion = error_frame(machine, zero, row.axis)
        placement = placement * pin.SE3(np.eye(3), np.array(row.origin))
        if machine.composition == "motion-last":
            placement, fixed = placement * location, motion
        else:
            fixed = location * motion
        kind = pin.JointModelPrismaticUnaligned if row.axis in LINEAR else pin.JointModelRevoluteUnaligned
        joint[row.name] = tree.addJoint(parent, kind(np.array(row.direction)), placement, row.name)
        behind[row.name] = fixed
    ends = {
        name: tree.addFrame(pin.Frame(f"frame of {name}", joint[name], 0, behind[name], pin.FrameType.OP_FRAME))
        for name in ("workpiece", tool)
    }
    data = tree.createData()
    coordinates = np.zeros(tree.nq)
    for row in rows:
        if row.axis:
            value = q[machine.axis_names.index(row.axis)]
            at = tree.idx_qs[joint[row.name]]
            coordinates[at] = value if row.axis in LINEAR else np.radians(value)
    pin.forwardKinematics(tree, data, coordinates)
    pin.updateFramePlacements(tree, data)
    work_T_tool = data.oMf[ends["workpiece"]].inverse() * data.oMf[ends[tool]]
    return work_T_tool.act(tool_mm), work_T_tool.rotation


def unit_vector(rng: np.random.Generator) -> tuple[float, ...]:
    vector = rng.normal(size=3)
    return tuple((vector / np.linalg.norm(vector)).tolist())


def random_tree(rng: np.random.Generator) -> list[Row]:
    """Return up to nine moving and a few fixed bodies on random lower ones, a workpiece and one to three tools."""
    rows = [Row("bed", None)]
    axes = rng.permutation(list(LINEAR + ROTARY))[: rng.integers(1, 10)].tolist()
    for axis in [*axes, *[None] * int(rng.integers(0, 3))]:
        lower = rows[rng.integers(len(rows))].name
        origin = tuple(rng.uniform(-300, 300, 3).tolist())
        rows.append(Row(f"body{len(rows)}", lower, axis, origin, unit_vector(rng)))
    tools = int(rng.integers(1, 4))
    carriers = [r.name for r in rows]
    leaves = ["workpiece", *(["tool"] if tools == 1 else [f"tool{k}" for k in range(1, tools + 1)])]
    return rows + [Row(leaf, carriers[rng.integers(len(carriers))]) for leaf in leaves]


def compare(rows: list[Row], machine: Machine, rng: np.random.Generator) -> None:
    q = rng.uniform(-400, 400, (POSES, len(machine.axis_names)))
    angular = np.array([t.angular for t in machine.terms])
    e = rng.uniform(-1, 1, (POSES, len(machine.terms))) * np.where(angular, 0.02, 2.0)
    tool_mm = rng.uniform(-200, 200, 3)
    for tool in machine.tool_names:
        chain = Chain(machine, tool)
        for errors in (None, e):
            tip, turned = chain.pose(q, errors, tool_mm)
            for i in range(POSES):
                expected = by_pinocchio(rows, machine, q[i], None if errors is None else errors[i], tool, tool_mm)
                np.testing.assert_allclose(tip[i], expected[0], rtol=0, atol=1e-9)
                np.testing.assert_allclose(turned[i], expected[1], rtol=0, atol=1e-12)
        found = chain.deviation(q, e, tool_mm)
        for i in range(POSES):
            actual = by_pinocchio(rows, machine, q[i], e[i], tool, tool_mm)
            ideal = by_pinocchio(rows, machine, q[i], None, tool, tool_mm)
            np.testing.assert_allclose(found.position_mm[i], actual[0] - ideal[0], rtol=0, atol=1e-9)
            expected_vector = pin.log3(actual[1] @ ideal[1].T)
            np.testing.assert_allclose(found.orientation_rad[i], expected_vector, rtol=0, atol=1e-12)


@given(st.integers(0, 2**32 - 1), st.sampled_from(["motion-last", "seed"]))
@settings(deadline=None, max_examples=80)
def test_random_trees_with_several_tools(seed: int, composition: str) -> None:
    rng = np.random.default_rng(seed)
    rows = random_tree(rng)
    compare(rows, described(rows, composition), rng)


@given(
    st.permutations("XYZW" + ROTARY),
    st.integers(0, 7),
    st.integers(1, 7),
    st.sampled_from(["motion-last", "seed"]),
    st.integers(0, 2**32 - 1),
)
@settings(deadline=None, max_examples=60)
def test_structure_strings_with_the_directions_of_iso_841(
    order: list[str], cut: int, length: int, composition: str, seed: int
) -> None:
    """One chain of up to seven axes: a workpiece-side axis moves its body backwards, a tool-side one forwards."""
    rng = np.random.default_rng(seed)
    work_side, tool_side = order[: min(cut, length)], order[min(cut, length) : length]
    origins = {axis: tuple(rng.uniform(-300, 300, 3).tolist()) for axis in order}
    rows = [Row("bed", None)]
    for side, axes, leaf in ((-1.0, work_side[::-1], "workpiece"), (1.0, tool_side, "tool")):
        lower = "bed"
        for axis in axes:
            along = [0.0, 0.0, 0.0]
            along["XYZUVWABC".index(axis) % 3] = side
            rows.append(Row(axis, lower, axis, origins[axis], tuple(along)))
            lower = axis
        rows.append(Row(leaf, lower))
    text = f'name = "random"\nstructure = "w {" ".join(work_side)} b {" ".join(tool_side)} t"\n'
    text += f'composition = "{composition}"\n[tool]\nerrors = true\n' + fixture_errors(order[:length])
    for axis in order[:length]:
        text += f"[axes.{axis}]\nrange = [-400.0, 400.0]\norigin_mm = {list(origins[axis])}\n"
    compare(rows, parse_machine(text), rng)
