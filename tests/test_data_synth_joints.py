"""Laws of joints, supports and drives, on small machines made for them."""

import numpy as np
import pytest

from data_synth.angle import PRESSURE_ANGLE, Encoder, Worm
from data_synth.assembly import Foot, Part, Structure
from data_synth.beam import Beam, Section
from data_synth.displacement import Displacement
from data_synth.fields import SpeedShift
from data_synth.guide import split_rotary, split_seed
from data_synth.joints import Carriage, LinearJoint, RotaryJoint, rotations
from data_synth.materials import STEEL
from data_synth.race import SECOND, Race
from data_synth.scale import Scale
from data_synth.screw import Screw
from data_synth.spindle import Spindle
from data_synth.supports import rest
from model.exceptions import MachineError
from model.machine import parse_machine

ALPHA = 1e-5
SPINDLE = Spindle(Foot((0.0, 0.0, 0.0)), {}, ALPHA, SpeedShift(um=0.0, at_rpm=1000.0))


def bar(name, origin, along, ends, across=((-50.0, 0.0, 0.0), (50.0, 0.0, 0.0), (0.0, 50.0, 0.0))):
    """Return a beam with two sections of three nodes each, name_0_0 to name_1_2."""
    return Beam(
        origin,
        along,
        tuple(Section(at, {f"{name}_{k}_{c}": place for c, place in enumerate(across)}) for k, at in enumerate(ends)),
        ALPHA,
    )


TOOL = "[tool]\nerrors = true\n"


def nodes(*names):
    found = [f"{name}_{k}_{c}" for name in names for k in range(2) for c in range(3)]
    return {name: i for i, name in enumerate(found)}


def field(node, rises):
    """Return the temperatures: each node that of the longest given beginning of its name."""
    return np.array(
        [max(((len(b), r) for b, r in rises.items() if name.startswith(b)), default=(0, 0.0))[1] for name in node]
    )


def machine(structure, axes, extra=""):
    tables = "".join(f"[axes.{name}]\nrange = {list(limits)}\n" for name, limits in axes.items())
    return parse_machine(f'name = "small"\nstructure = "{structure}"\n{tables}{extra}')


def scale(axis, along, name="scale", sign=1, **more):
    return Scale(axis, along, 0.0, sign, 0.0, (name,), (-2000.0, 2000.0), ALPHA, **more)


def test_what_rests_on_two_places_goes_with_a_rigid_body_that_passes_through_them():
    rng = np.random.default_rng(0)
    shift, turn = rng.normal(size=(2, 3))
    feet = [Foot((10.0, -500.0, 30.0)), Foot((60.0, 700.0, 30.0))]
    moved = [Displacement((shift + np.cross(turn, foot.at_mm))[None, :, None], turn[None, :, None]) for foot in feet]
    got = rest(feet, moved)
    middle = np.mean([foot.at_mm for foot in feet], axis=0)
    np.testing.assert_allclose(got.shift[0, :, 0], shift + np.cross(turn, middle), atol=1e-12)
    np.testing.assert_allclose(got.turn[0, :, 0], turn, atol=1e-12)


def test_the_foot_that_holds_leads_along_the_line_of_the_two():
    feet = [Foot((0.0, 0.0, 0.0), hold=1.0), Foot((100.0, 0.0, 0.0), hold=0.0)]
    moved = [Displacement(np.array([[[x], [0.0], [0.0]]]), np.zeros((1, 3, 1))) for x in (2.0, 7.0)]
    np.testing.assert_allclose(rest(feet, moved).shift[0, :, 0], [2.0, 0.0, 0.0])
    even = [Foot(foot.at_mm) for foot in feet]
    np.testing.assert_allclose(rest(even, moved).shift[0, :, 0], [4.5, 0.0, 0.0])


def gantry(drives):
    walls = {
        "floor": Part(bar("floor", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 2000.0))),
        "left": Part(bar("left", (0.0, 1000.0, 0.0), (0.0, 0.0, 1.0), (0.0, 500.0)), (Foot((0.0, 1000.0, 0.0)),)),
        "right": Part(bar("right", (0.0, -1000.0, 0.0), (0.0, 0.0, 1.0), (0.0, 500.0)), (Foot((0.0, -1000.0, 0.0)),)),
    }
    carriages = tuple(Carriage((0.0, y, 500.0), on=on) for on, y in (("left", 1000.0), ("right", -1000.0)))
    structure = Structure({"bed": walls}, Foot((0.0, 0.0, 0.0)), {"X": LinearJoint(carriages, drives)}, SPINDLE)
    node = {**nodes("floor", "left", "right"), "scale": 18, "scale_left": 19, "scale_right": 20}
    return structure, node


def test_a_bridge_on_a_taller_wall_rolls():
    structure, node = gantry((scale("X", 0),))
    got = structure.fields(machine("w b X t", {"X": (0.0, 1000.0)}), node, 5)
    rise = field(node, {"left": 3.0})
    roll = (got.location["X"] @ rise)[3] + (got.motion["X"] @ rise)[3]
    np.testing.assert_allclose(roll, 3.0 * ALPHA * 500.0 / 2000.0, rtol=1e-9)


def test_two_scales_set_the_yaw_and_one_does_not():
    rise = {"scale_left": 4.0}
    both = tuple(scale("X", 0, f"scale_{side}") for side in ("left", "right"))
    described = machine("w b X t", {"X": (0.0, 1000.0)})
    structure, node = gantry(both)
    got = structure.fields(described, node, 5)
    yaw = (got.location["X"] @ field(node, rise))[5] + (got.motion["X"] @ field(node, rise))[5]
    position = got.positions["X"]
    np.testing.assert_allclose(yaw, -4.0 * ALPHA * position / 2000.0, atol=1e-15)  # left is +Y
    structure, node = gantry((scale("X", 0),))
    got = structure.fields(described, node, 5)
    assert not (got.motion["X"] @ field(node, {"scale": 4.0}))[5].any()


def test_an_axis_stands_where_its_scales_marks_are():
    structure, node = gantry((scale("X", 0),))
    got = structure.fields(machine("w b X t", {"X": (0.0, 1000.0)}), node, 5)
    rise = field(node, {"scale": 2.5})
    along = (got.location["X"] @ rise)[0] + (got.motion["X"] @ rise)[0]
    np.testing.assert_allclose(along, 2.5 * ALPHA * got.positions["X"], atol=1e-15)


def test_a_portal_that_grows_evenly_lifts_its_beam_and_a_beam_bows_between_its_feet():
    """A beam warmer on top by g bows up as a circle of radius 1 / (α g): α g L² / 8 in the middle."""
    parts = {
        "floor": Part(bar("floor", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 2000.0))),
        **{
            side: Part(bar(side, (0.0, y, 0.0), (0.0, 0.0, 1.0), (0.0, 800.0)), (Foot((0.0, y, 0.0)),))
            for side, y in (("left", 1000.0), ("right", -1000.0))
        },
        "beam": Part(
            bar(
                "beam",
                (0.0, 0.0, 800.0),
                (0.0, 1.0, 0.0),
                (-1000.0, 1000.0),
                ((-80.0, 0, -60.0), (80.0, 0, -60.0), (0, 0, 120.0)),
            ),
            (Foot((0.0, 1000.0, 800.0), on="left"), Foot((0.0, -1000.0, 800.0), on="right")),
        ),
    }
    joint = LinearJoint((Carriage((0.0, 0.0, 800.0), on="beam"),), (scale("Y", 1),))
    structure = Structure({"bed": parts}, Foot((0.0, 0.0, 0.0)), {"Y": joint}, SPINDLE)
    node = {**nodes("floor", "left", "right", "beam"), "scale": 24}
    got = structure.fields(machine("w b Y t", {"Y": (-1000.0, 1000.0)}), node, 5)

    def height(rises):
        rise = field(node, rises)
        p = got.positions["Y"]
        location = got.location["Y"] @ rise
        return location[2] + location[3] * p + (got.motion["Y"] @ rise)[2]

    np.testing.assert_allclose(height({"left": 2.0, "right": 2.0}), 2.0 * ALPHA * 800.0, rtol=1e-9)
    warm = {f"beam_{k}_2": 1.8 for k in range(2)}  # 180 mm above the others: 0.01 K/mm
    bowed = height(warm) - height(dict.fromkeys(("beam_0", "beam_1"), 0.6))
    wanted = 0.5 * ALPHA * 0.01 * (1000.0**2 - got.positions["Y"] ** 2)
    np.testing.assert_allclose(bowed - bowed[0], wanted, atol=1e-9)
    assert bowed[2] - bowed[0] == pytest.approx(ALPHA * 0.01 * 2000.0**2 / 8)


def ram(drive):
    body = {"ram": Part(bar("ram", (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1500.0)))}
    joint = LinearJoint((Carriage((0.0, 0.0, 1200.0)),), (drive,), rail="body")
    structure = Structure({"Z": body}, Foot((0.0, 0.0, 0.0)), {"Z": joint}, SPINDLE)
    return structure, {**nodes("ram"), **{f"screw_{k}": 6 + k for k in range(2)}}


def test_a_rams_bending_shows_as_it_comes_out():
    """Bent by a gradient g across, its tip leans by α g L over the length L below the shoes."""
    screw = Screw("Z", 2, 1200.0, 1, 1900.0, 900.0, ("screw_0", "screw_1"), (900.0, 1400.0, 1900.0), ALPHA)
    structure, node = ram(screw)
    described = machine("w b Z t", {"Z": (-800.0, 0.0)}, TOOL)
    got = structure.fields(described, node, 5)
    rise = field(node, {"ram_0_1": 1.0, "ram_1_1": 1.0})  # 0.01 K/mm towards +x
    turn = (got.location["Z"] + got.location["T"]) @ rise
    pitch = turn[4] + (got.motion["Z"] @ rise)[4]
    out = 1200.0 - got.positions["Z"]  # from the shoes down to the nose
    np.testing.assert_allclose(np.diff(pitch) / np.diff(out), (pitch[-1] - pitch[0]) / (out[-1] - out[0]), rtol=1e-9)
    assert abs((pitch[-1] - pitch[0]) / (out[-1] - out[0])) == pytest.approx(ALPHA * 0.01)


def test_a_ram_grows_from_its_nut_however_far_it_is_out():
    screw = Screw("Z", 2, 1500.0, 1, 1900.0, 900.0, ("screw_0", "screw_1"), (900.0, 1400.0, 1900.0), ALPHA)
    structure, node = ram(screw)
    described = machine("w b Z t", {"Z": (-500.0, 0.0)}, TOOL)
    got = structure.fields(described, node, 5)
    rise = field(node, {"ram": 3.0})
    nose = (got.location["Z"] + got.location["T"])[2] @ rise + got.motion["Z"][2] @ rise
    np.testing.assert_allclose(nose, -3.0 * ALPHA * 1500.0, rtol=1e-9)


TABLE = bar("table", (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (-100.0, 0.0), ((-200.0, 0, 0), (200.0, 0, 0), (0, 200.0, 0)))
BASE = bar("base", (0.0, 0.0, -400.0), (0.0, 0.0, 1.0), (0.0, 300.0))


def turntable(angle=None, growth=None, races=()):
    joint = RotaryJoint((Carriage((0.0, 0.0, -100.0)),), growth or {}, angle, races)
    bodies = {"bed": {"base": Part(BASE)}, "C": {"table": Part(TABLE)}}
    structure = Structure(bodies, Foot((0.0, 0.0, -400.0)), {"C": joint}, SPINDLE)
    return structure, nodes("table", "base"), machine("w C b t", {"C": (-360.0, 360.0)}, TOOL)


def test_what_stands_still_moves_a_rotary_axis_line_and_nothing_else():
    structure, node, described = turntable(growth={"base_1_0": (0.0, 0.0, 40.0)})
    got = structure.fields(described, node, 9)
    rise = field(node, {"base": 1.0, "base_0_1": 5.0, "base_1_2": 8.0})
    np.testing.assert_allclose(got.motion["C"] @ rise, 0.0, atol=1e-15)
    assert np.abs(got.location["C"] @ rise)[[0, 1, 2, 3, 4]].min() > 1e-6
    grown = structure.fields(described, node, 9).location["C"] - turntable()[0].fields(described, node, 9).location["C"]
    np.testing.assert_allclose(grown[:, node["base_1_0"]], [0, 0, 40.0 * STEEL.expansion_per_K, 0, 0, 0], atol=1e-18)


def test_a_tables_uneven_warmth_turns_with_it():
    structure, node, described = turntable()
    got = structure.fields(described, node, 9)
    rise = field(node, {"table_0_1": 4.0, "table_1_1": 4.0})
    np.testing.assert_allclose((got.location["C"] @ rise)[[0, 1, 3, 4]], 0.0, atol=1e-12)
    motion = got.motion["C"] @ rise
    np.testing.assert_allclose(motion, motion[:, :1] * np.ones(motion.shape[1]), atol=1e-12)
    assert abs(motion[4, 0]) > 1e-6  # it tilts about y for a warm +x side


EVEN_IN_Y = {"table_0_2": 2.0, "table_1_2": 2.0}


def test_an_encoder_reads_wrong_once_per_turn_by_shift_over_radius():
    """A disc pushed in +x by s, its marks passing the head in -x: the table is s / R cos q ahead."""
    structure, node, described = turntable(Encoder((0.0, 0.0, -100.0 + 40.0), 80.0, (-1.0, 0.0, 0.0)))
    got = structure.fields(described, node, 9)
    rise = field(node, {**EVEN_IN_Y, "table_0_1": 4.0, "table_1_1": 4.0})
    pushed = TABLE.displacement((0.0, 0.0, -60.0), (0.0, 0.0, -100.0), node).shift[0, 0] @ rise
    # On the workpiece side C turns about -z.
    angle = -((got.location["C"] @ rise)[5] + (got.motion["C"] @ rise)[5])
    np.testing.assert_allclose(angle, pushed / 80.0 * np.cos(np.radians(got.positions["C"])), atol=1e-15)
    assert abs(pushed) > 1e-6


def test_a_warm_worm_wheel_turns_its_table_by_its_flanks():
    worm = Worm(
        (0.0, 0.0, -60.0), 90.0, (1.0, 0.0, 0.0), wheel={"table_0_0": 1.0}, housing={"base_1_0": 1.0}, centre_mm=120.0
    )
    structure, node, described = turntable(worm)
    got, without = (s.fields(described, node, 9) for s in (structure, turntable()[0]))
    turned = -(got.location["C"] - without.location["C"])[5]  # about -z
    wanted = STEEL.expansion_per_K * 120.0 * np.tan(PRESSURE_ANGLE) / 90.0
    assert turned[node["base_1_0"]] == pytest.approx(-wanted)
    assert turned @ np.ones(len(node)) == pytest.approx(0.0, abs=1e-15)


RACE = Race(250.0, {"table_0_0": 0.4, "table_0_1": 0.6}, {"base_1_0": 1.0}, phase_degree=20.0)


def run_out(angle=None, race=RACE, **rises):
    """Return the motion and location terms of C that the race adds, shapes (6, n) and (6,), and the positions."""
    with_race, node, described = turntable(angle, races=(race,))
    got, without = (s.fields(described, node, 33) for s in (with_race, turntable(angle)[0]))
    rise = field(node, rises)
    motion, location = ((getattr(got, k)["C"] - getattr(without, k)["C"]) @ rise for k in ("motion", "location"))
    return motion, location, got.positions["C"]


def test_run_out_is_a_share_of_what_one_ring_grows_beyond_the_other():
    motion, location, at = run_out(table=4.0, base=1.0)
    size = RACE.share * STEEL.expansion_per_K * RACE.diameter_mm * 3.0
    np.testing.assert_allclose(location, 0.0, atol=1e-12)  # the line stands where it stood
    wave = np.radians(at - RACE.phase_degree)
    axial = -size * (np.cos(wave) + SECOND * np.cos(2.0 * wave))  # on the workpiece side C turns about -z
    np.testing.assert_allclose(motion[2], axial, atol=1e-12)
    lean = np.linalg.norm(motion[3:5], axis=0)
    np.testing.assert_allclose(lean * RACE.diameter_mm / 2, size * (1.0 + SECOND * np.cos(2.0 * wave)), atol=1e-12)
    assert np.abs(motion[:5]).max(axis=1).min() > 0.1 * np.abs(motion[:5]).max(axis=1).max() / RACE.diameter_mm
    opposite, _, _ = run_out(table=1.0, base=4.0)
    np.testing.assert_allclose(opposite, -motion, atol=1e-15)
    np.testing.assert_allclose(run_out(table=4.0, base=4.0)[0], 0.0, atol=1e-15)


def test_run_out_comes_back_after_a_turn_and_is_of_first_and_second_order():
    motion, _, at = run_out(table=4.0)
    np.testing.assert_allclose(motion[:, at <= 0.0], motion[:, at >= 0.0], atol=1e-12)
    q = np.radians(at)
    waves = np.column_stack([np.ones(len(q)), np.cos(q), np.sin(q), np.cos(2.0 * q), np.sin(2.0 * q)])
    fit, *_ = np.linalg.lstsq(waves, motion.T, rcond=None)
    np.testing.assert_allclose(waves @ fit, motion.T, atol=1e-12)
    assert np.linalg.norm(fit[3:, :5], axis=0).min() > 1e-6  # the oval of the standing ring shows in all


def test_run_out_moves_an_encoders_disc_and_so_the_angle():
    head = Encoder((0.0, 0.0, -100.0), 80.0, (-1.0, 0.0, 0.0))
    described = turntable()[2]
    motion, location, at = run_out(head, table=4.0)
    there = (
        rotations(described.axes["C"], at) @ (motion[:3] - np.cross(motion[3:], [0, 0, 100.0], 0, 0, 0)).T[..., None]
    )
    np.testing.assert_allclose(-(motion[5] + location[5]), there[:, 0, 0] / 80.0, atol=1e-12)


def test_races_of_two_bearings_tilt_what_turns_by_their_difference_over_the_span():
    """Two that give way to opposite sides by s turn it by 2 s over their distance; alike, they only shift it."""

    def cradle(second):
        places = (Carriage((-300.0, 0.0, 0.0), hold=1.0), Carriage((300.0, 0.0, 0.0), hold=0.0))
        races = tuple(Race(200.0, {"ring": 1.0}, {"housing": 1.0}, phase) for phase in (0.0, second))
        structure = Structure({}, Foot((0.0, 0.0, 0.0)), {"A": RotaryJoint(places, races=races)}, SPINDLE)
        got = structure.fields(machine("w A b t", {"A": (-360.0, 360.0)}, TOOL), {"ring": 0, "housing": 1}, 9)
        return got.motion["A"] @ np.array([2.0, 0.0])

    size = 0.1 * STEEL.expansion_per_K * 200.0 * 2.0
    alike, opposite = cradle(0.0), cradle(180.0)
    assert np.abs(alike[1:3]).max() == pytest.approx(1.5 * size)
    np.testing.assert_allclose(alike[3:], 0.0, atol=1e-15)
    np.testing.assert_allclose(opposite[1:3], 0.0, atol=1e-15)
    assert np.abs(opposite[4:]).max() == pytest.approx(1.5 * size / 300.0)
    np.testing.assert_allclose(alike[0], opposite[0], atol=1e-15)  # along its line the fixed bearing leads


@pytest.mark.parametrize("limits", [(-360.0, 360.0), (-120.0, 30.0)])
def test_a_rotary_path_is_split_and_put_together_again(limits):
    described = machine("w b C t", {"C": limits})
    axis = described.axes["C"]
    rng = np.random.default_rng(1)
    stands, turns, wild = rng.normal(size=(3, 2, 3, 4))
    turns[:, 2] = 0.0  # along and about the line a constant is the axis' place

    def path(q):
        wave = np.cos(np.radians(2.0 * q))[:, None, None] * wild[:, None]
        return Displacement(*(s + rotations(axis, q) @ t + w for s, t, w in zip(stands, turns, wave, strict=True)))

    def turned(q):
        return rotations(axis, q)

    at = np.linspace(*limits, 13)
    got = split_rotary(path, axis.direction, limits, at, turned)
    there = path(at)
    for rows, whole in ((slice(0, 3), there.shift), (slice(3, 6), there.turn)):
        again = got.location[rows] + rotations(axis, at) @ got.motion[rows].transpose(1, 0, 2)
        np.testing.assert_allclose(again, whole, atol=1e-12)
    wild[:] = 0.0
    got = split_rotary(path, axis.direction, limits, at, turned)
    np.testing.assert_allclose(got.location, np.concatenate(stands), atol=1e-9)
    np.testing.assert_allclose(got.motion, np.concatenate(turns)[:, None] * np.ones((1, 13, 1)), atol=1e-9)


def test_in_the_seeds_composition_the_slope_of_a_path_stays_in_its_straightness():
    described = machine("w b Z t", {"Z": (0.0, 500.0)})
    axis = described.axes["Z"]

    def path(z):
        return Displacement(
            np.stack([2.0 + 3e-3 * z, 0.0 * z, 1e-2 * z], 1)[..., None],
            np.tile([[[1e-3], [3e-3], [0.0]]], (len(z), 1, 1)),
        )

    joined = Displacement(np.full((1, 3, 1), 0.1), np.zeros((1, 3, 1)))
    at = np.linspace(0.0, 500.0, 6)
    got = split_seed(path, (0.0, 500.0), at, lambda z: rotations(axis, z), frozenset({4}), joined)
    np.testing.assert_allclose(got.location[:, 0], [0.1, 0.1, 0.1, 0.0, 3e-3, 0.0])
    np.testing.assert_allclose(got.motion[0, :, 0], 1.9 + 3e-3 * at)
    np.testing.assert_allclose(got.motion[[3, 4], :, 0].T, np.tile([1e-3, 0.0], (6, 1)), atol=1e-15)


def refusals():
    joint = LinearJoint((Carriage((0.0, 0.0, 0.0)),), (scale("X", 0),))
    ground = Foot((0.0, 0.0, 0.0))
    one = {"X": (0.0, 1000.0)}
    turn = RotaryJoint((Carriage((0.0, 0.0, 0.0)),))
    base = {"base": Part(BASE)}
    yield "the structure of machine 'small' must have one joint", Structure({}, ground, {}, SPINDLE), ("w b X t", one)
    yield (
        "the structure of machine 'small' must be bed, axes and one tool, got body 'saddle'",
        Structure({"saddle": {}}, ground, {"X": joint}, SPINDLE),
        ("w b X t", one),
    )
    yield "axis 'X' must have a linear joint", Structure({}, ground, {"X": turn}, SPINDLE), ("w b X t", one)
    two = LinearJoint(joint.carriages, joint.drives * 2)
    yield "axis 'X' must have one drive", Structure({}, ground, {"X": two}, SPINDLE), ("w b X t", one)
    back = LinearJoint(joint.carriages, (scale("X", 0, sign=-1),))
    yield "a drive of axis 'X' must be for it", Structure({}, ground, {"X": back}, SPINDLE), ("w b X t", one)
    three = LinearJoint(joint.carriages * 3, joint.drives)
    yield "a part must rest on one or two places, got 3", Structure({}, ground, {"X": three}, SPINDLE), ("w b X t", one)
    same = LinearJoint(joint.carriages * 2, joint.drives)
    yield "the two places a part rests on must lie apart", Structure({}, ground, {"X": same}, SPINDLE), ("w b X t", one)
    off = RotaryJoint((Carriage((100.0, 0.0, 0.0)),))
    yield "the bearings of axis 'C'", Structure({}, ground, {"C": off}, SPINDLE), ("w C b t", {"C": (0.0, 360.0)})
    ringed = RotaryJoint((Carriage((0.0, 0.0, 0.0)),), races=(RACE, RACE))
    yield (
        "axis 'C' must have one race for each of its 1 bearings, or none, got 2",
        Structure({}, ground, {"C": ringed}, SPINDLE),
        ("w C b t", {"C": (0.0, 360.0)}),
    )
    seat = Structure({"bed": base}, Foot((0.0, 0.0, -400.0)), {"X": joint}, SPINDLE)
    yield (
        "machine 'small' must have the ground of its structure where the bed carries the workpiece",
        seat,
        ("w b X t", one),
    )
    lost = LinearJoint((Carriage((0.0, 0.0, 0.0), on="bass"),), (scale("X", 0, sign=-1),))
    yield (
        "body 'bed' has no part 'bass'; did you mean 'base'",
        Structure({"bed": base}, ground, {"X": lost}, SPINDLE),
        ("w X b t", {"X": (0.0, 1000.0)}, TOOL),
    )
    loose = {"bed": {"base": Part(BASE), "more": Part(BASE)}}
    yield (
        "part 'more' of body 'bed' must stand on another",
        Structure(loose, ground, {"X": joint}, SPINDLE),
        ("w b X t", one),
    )


@pytest.mark.parametrize(
    ("message", "structure", "described"), [pytest.param(*case, id=case[0]) for case in refusals()]
)
def test_a_structure_that_does_not_fit_is_refused_in_one_sentence(message, structure, described):
    node = {**nodes("base", "table"), "scale": 12}
    with pytest.raises(MachineError, match=f"^{message}"):
        structure.fields(machine(*described), node, 5)
