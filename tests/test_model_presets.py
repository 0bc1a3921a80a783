"""The machine descriptions that come with the package."""

import numpy as np
import pytest

from model.chain import Chain
from model.compensation import compensate
from model.error_map import ErrorMap
from model.machine import load_machine, preset
from model.terms import DIRECTIONS

# The axes on the way from the bed to the workpiece, and to the tool.
PRESETS = {
    "bridge3": ("X", "YZ"),
    "gantry3": ("", "XYZ"),
    "head5": ("", "XYZCA"),
    "hmc3": ("X", "ZY"),
    "hmc4": ("ZB", "XY"),
    "knee3": ("ZYX", ""),
    "mixed5": ("XC", "YZB"),
    "seed3": ("YX", "Z"),
    "trunnion5": ("AC", "YXZ"),
    "trunnion5bc": ("XBC", "YZ"),
    "vmc3": ("YX", "Z"),
}
RNG = np.random.default_rng(6)


def test_every_preset_is_tested() -> None:
    assert sorted(path.stem for path in preset("vmc3").parent.glob("*.toml")) == sorted(PRESETS)


@pytest.mark.parametrize("name", PRESETS)
def test_preset_says_what_it_is_and_has_its_axes_and_terms(name: str) -> None:
    path = preset(name)
    machine = load_machine(path)
    assert machine.name == name == path.stem
    assert path.read_text(encoding="utf-8").startswith("# ")
    moved = {side: "".join(b.axis for b in machine.bodies if b.axis and b.side == side) for side in (-1, 1)}
    assert (moved[-1], moved[1]) == PRESETS[name]
    axes = len(machine.axis_names)
    moving = [t for t in machine.terms if t.axis in machine.axes]
    assert len(moving) == 12 * axes == {3: 36, 4: 48, 5: 60}[axes]
    holder = [f"E{d}0T" for d in DIRECTIONS] if machine.tool.errors else []
    assert [t.name for t in machine.terms if t not in moving] == holder


@pytest.mark.parametrize("name", PRESETS)
def test_coordinates_zero_put_the_tip_in_the_origin_of_the_workpiece(name: str) -> None:
    """And the tool points in -Z; zero lies in every range, so that the pose can be taken."""
    machine = load_machine(preset(name))
    tip, turned = Chain(machine).pose(np.zeros((1, len(machine.axis_names))))
    np.testing.assert_allclose(tip[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(turned[0] @ machine.tool.direction, [0.0, 0.0, -1.0], atol=1e-15)
    assert all(axis.low <= 0.0 <= axis.high for axis in machine.axes.values())


@pytest.mark.parametrize("name", [n for n in PRESETS if n != "seed3"])
def test_coordinates_move_the_tool_against_the_workpiece_as_iso_841_says(name: str) -> None:
    """Linear axes at rotary zero move the tip in +X, +Y, +Z; +A, +B, +C turn the tool right-handed."""
    machine = load_machine(preset(name))
    jacobian = Chain(machine).jacobian(np.zeros((1, len(machine.axis_names))))[0]
    for column, axis in enumerate(machine.axis_names):
        expected = np.zeros(3)
        expected["XYZ".find(axis) if axis in "XYZ" else "ABC".find(axis)] = machine.axes[axis].to_internal
        rows = slice(3, 6) if machine.axes[axis].rotary else slice(0, 3)
        np.testing.assert_allclose(jacobian[rows, column], expected, atol=1e-15, err_msg=axis)


@pytest.mark.parametrize("name", [n for n in PRESETS if n.startswith("trunnion") or n == "hmc4"])
def test_the_point_under_the_tip_stays_when_the_table_turns(name: str) -> None:
    """The workpiece frame sits on the line of the axis that carries it."""
    machine = load_machine(preset(name))
    q = np.zeros((5, len(machine.axis_names)))
    q[:, machine.axis_names.index(PRESETS[name][0][-1])] = np.linspace(-180.0, 180.0, 5)
    np.testing.assert_allclose(Chain(machine).tip(q), 0.0, atol=1e-12)


@pytest.mark.parametrize("name", PRESETS)
def test_errors_of_a_new_machine_are_compensated_over_the_whole_range(name: str) -> None:
    """Terms of 10 µm and 10 µrad: the tip comes back to 1 nm, and the correction stays below the limit."""
    machine = load_machine(preset(name))
    chain = Chain(machine)
    rows = [(t.name, None if t.kind == "location" else 0.0, float(RNG.uniform(-10, 10))) for t in machine.terms]
    errors = ErrorMap.from_rows(machine, rows)
    axes = [machine.axes[a] for a in machine.axis_names]
    q = RNG.uniform([a.low for a in axes], [a.high for a in axes], (32, len(axes)))
    found = compensate(chain, q, errors)
    tip = chain.tip(found.corrected, errors.evaluate(found.corrected))
    np.testing.assert_allclose(tip, chain.tip(q), rtol=0, atol=1e-6)
    linear = [i for i, a in enumerate(axes) if not a.rotary]
    assert np.abs(found.corrected - q)[:, linear].max() * 1e3 < machine.limits.max_correction_um
