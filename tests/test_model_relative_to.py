"""Error tables as instruments report them, and as the chain takes them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from machines import ARRANGEMENTS, FIVE_AXIS, five_axis_text, machine_text

from model.chain import Chain
from model.error_map import ErrorMap, Row
from model.exceptions import DataError
from model.machine import Machine, load_machine, parse_machine, preset
from model.relative_to import FunctionalPoint, to_body, to_tool, turns_sign
from model.squareness import SquarenessSign, squareness, squareness_rows
from model.terms import DIRECTIONS

MACHINES = [parse_machine(machine_text(s)) for s in ARRANGEMENTS] + [
    parse_machine(five_axis_text(s)) for s in FIVE_AXIS
]
UNITS = np.array([1e-3] * 3 + [1e-6] * 3)
PAIRS = {"XY": ("X", "Y"), "XZ": ("X", "Z"), "YZ": ("Y", "Z")}


def table(machine: Machine, axis: str, rng: np.random.Generator, knots: int = 4) -> tuple[np.ndarray, np.ndarray, list]:
    """Return positions, six motion terms [µm, µrad] at them, and both as rows."""
    at = np.linspace(machine.axes[axis].low, machine.axes[axis].high, knots)
    values = rng.uniform(-20, 20, (6, knots))
    rows = [
        (f"E{d}{axis}", float(p), float(v))
        for d, r in zip(DIRECTIONS, values, strict=True)
        for p, v in zip(at, r, strict=True)
    ]
    return at, values, rows


def seen(chain: Chain, q: np.ndarray, rows: list[Row], tool_mm: np.ndarray) -> np.ndarray:
    """Return the tool's motion against the workpiece (n, 6) [mm, rad] that the exact chain has with an error table."""
    errors = ErrorMap.from_rows(chain.machine, rows)
    found = chain.deviation(q, errors.evaluate(q), tool_mm)
    return np.concatenate([found.position_mm, found.orientation_rad], axis=1)


@given(st.sampled_from(MACHINES), st.data(), st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=120)
def test_a_converted_table_makes_the_chain_show_what_the_instrument_saw(
    machine: Machine, data: st.DataObject, seed: int
) -> None:
    """Any axis, measured along any line through the volume, angles and all, with the rotary axes anywhere.

    The instrument writes along the axes of the measured body. Where these point in the workpiece frame, the tilts show
    that the body's own angular errors make.
    """
    rng = np.random.default_rng(seed)
    axis = data.draw(st.sampled_from(machine.axis_names))
    chain = Chain(machine)
    elsewhere = {a: float(rng.uniform(machine.axes[a].low, machine.axes[a].high)) for a in machine.axis_names}
    tool_mm = rng.uniform(-200, 200, 3)
    at, values, rows = table(machine, axis, rng)
    q = np.tile([elsewhere[a] for a in machine.axis_names], (len(at), 1))
    q[:, machine.axis_names.index(axis)] = at
    del elsewhere[axis]
    point = {axis: FunctionalPoint(elsewhere, tuple(tool_mm.tolist()))}
    body = to_body(machine, rows, point)
    side = next(b.side for b in machine.bodies if b.axis == axis)
    single = [seen(chain, q, [(f"E{d}{axis}", 0.0, 1.0)], tool_mm)[:, 3:] for d in "ABC"]
    work_R_body = side * np.stack(single, axis=2) / 1e-6
    expected = np.einsum("nij,njk->nik", work_R_body, (values.T * UNITS).reshape(len(at), 2, 3).swapaxes(1, 2))
    expected = expected.swapaxes(1, 2).reshape(len(at), 6)
    found = seen(chain, q, body, tool_mm)
    np.testing.assert_allclose(found[:, :3], expected[:, :3], rtol=0, atol=2e-6)  # products of two errors
    np.testing.assert_allclose(found[:, 3:], expected[:, 3:], rtol=0, atol=2e-9)


@given(st.sampled_from(MACHINES), st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=40)
def test_there_and_back(machine: Machine, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows: list[Row] = [r for a in machine.axis_names for r in table(machine, a, rng)[2]]
    rows += [(t.name, None, float(rng.uniform(-9, 9))) for t in machine.terms if t.kind == "location"]
    assert to_tool(machine, to_body(machine, rows)) == rows == to_body(machine, to_tool(machine, rows))
    points = {a: FunctionalPoint({machine.axis_names[-1]: 30.0}, (10.0, -20.0, -80.0)) for a in machine.axis_names[:3]}
    back = to_tool(machine, to_body(machine, rows, points), points)
    assert len(back) == len(rows)
    table_of = {(name, position): value for name, position, value in rows}
    for name, position, value in back:
        assert value == pytest.approx(table_of[name, position], abs=1e-9)


@pytest.mark.parametrize(("structure", "side"), [("w b X Y Z t", 1), ("w X b Y Z t", -1), ("w Z X Y b t", -1)])
def test_displacements_alone_change_only_their_sign(structure: str, side: int) -> None:
    """A carriage 10 µm too far in +X shows as the tool 10 µm too far on the tool side, 10 µm behind as a table."""
    machine = parse_machine(machine_text(structure))
    rows: list[Row] = [("EXX", 0.0, 10.0), ("EXX", 800.0, 4.0), ("EYX", 400.0, 3.0)]
    body = to_body(machine, rows)
    assert body == [(name, position, side * value) for name, position, value in rows]
    q = np.array([[400.0, 20.0, 100.0]])
    np.testing.assert_allclose(seen(Chain(machine), q, body, np.zeros(3))[0], [7e-3, 3e-3, 0, 0, 0, 0], atol=1e-12)


def test_forgetting_the_conversion_doubles_the_error() -> None:
    """Correcting by an unconverted table moves the tool as far again in the wrong direction."""
    machine = parse_machine(machine_text("w X b Y Z t"))
    rows: list[Row] = [("EXX", 0.0, 10.0)]
    chain, q, tool = Chain(machine), np.array([[400.0, 20.0, 100.0]]), np.zeros(3)
    really, believed = seen(chain, q, to_body(machine, rows), tool), seen(chain, q, rows, tool)
    assert (really - believed)[0, 0] == pytest.approx(2 * 10e-3, abs=1e-12)


def test_on_a_table_the_lever_grows_with_its_own_position() -> None:
    """A table X yaws by -10 µrad where its tool-relative straightness shows nothing, at X = 400.

    The tip stands 400 mm from the table's origin in the table's frame, where the yaw moves it by -10e-6 * 400 mm
    against +Y; a table that shows nothing there must stand 4 µm further in +Y.
    """
    machine = parse_machine(
        'name = "t"\nstructure = "w X b Y Z t"\n' + "".join(f"[axes.{a}]\nrange = [0, 800]\n" for a in "XYZ")
    )
    rows: list[Row] = [("ECX", 0.0, 0.0), ("ECX", 400.0, 10.0)]
    body = {(n, p): v for n, p, v in to_body(machine, rows, {"X": FunctionalPoint()})}
    assert body["ECX", 400.0] == pytest.approx(-10.0)
    assert body["EYX", 400.0] == pytest.approx(4.0)
    assert body["EYX", 0.0] == body["EXX", 400.0] == body["EZX", 400.0] == 0.0
    # On the tool side the lever is the tool's and the outer axes', here none.
    head = parse_machine(machine.source.replace("w X b Y Z t", "w b X Y Z t"))
    assert {(n, p): v for n, p, v in to_body(head, rows, {"X": FunctionalPoint()})}["EYX", 400.0] == 0.0


def lines_angle(chain: Chain, rows: list[Row], first: str, second: str) -> float:
    """Return by how much the angle between two axes' positive directions exceeds 90° [µrad], from tips alone."""
    machine = chain.machine
    e = ErrorMap.from_rows(machine, rows).evaluate(np.zeros((3, len(machine.axis_names))))
    q = np.zeros((3, len(machine.axis_names)))
    q[1, machine.axis_names.index(first)] = q[2, machine.axis_names.index(second)] = 300.0
    tip = chain.tip(q, e, np.zeros(3))
    a, b = (v / np.linalg.norm(v) for v in (tip[1] - tip[0], tip[2] - tip[0]))
    return float(np.arccos(a @ b) - np.pi / 2) * 1e6


@pytest.mark.parametrize("structure", [*ARRANGEMENTS, *FIVE_AXIS])
def test_squareness_is_the_angle_between_the_lines_that_the_tip_draws(structure: str) -> None:
    """On either side of the bed, whichever axis carries the other, all three at once."""
    machine = parse_machine(five_axis_text(structure) if structure in FIVE_AXIS else machine_text(structure))
    chain = Chain(machine)
    angles = {"XY": 10.0, "XWZ": -7.0, "YZ": 4.0}
    opened: dict[SquarenessSign, dict[str, float]] = {
        "LARGER_THAN_90": {"XY": 10.0, "XZ": -7.0, "YZ": 4.0},
        "RIGHT_HANDED": {"XY": 10.0, "XZ": 7.0, "YZ": 4.0},  # XZ > 0: less than 90°, as CARTO says
    }
    for sign, expected in opened.items():
        rows = squareness_rows(machine, angles, sign)
        for pair, (first, second) in PAIRS.items():
            assert lines_angle(chain, rows, first, second) == pytest.approx(expected[pair], abs=1e-3)
        back = squareness(machine, rows, sign)
        assert back == pytest.approx({"XY": 10.0, "XZ": -7.0, "YZ": 4.0})
        assert to_body(machine, rows) == rows  # a line lies where it lies


def test_squareness_of_axes_whose_coordinates_run_backwards() -> None:
    """With +X of the seed's table moving the table in +X, the tool goes to -X, and larger turns to smaller."""
    text = machine_text("w X Y b Z t").replace("[axes.X]", "[axes.X]\ndirection = [1.0, 0.0, 0.0]")
    machine = parse_machine(text)
    rows = squareness_rows(machine, {"XZ": 5.0, "XY": 3.0}, "LARGER_THAN_90")
    assert lines_angle(Chain(machine), rows, "X", "Z") == pytest.approx(5.0, abs=1e-3)
    assert lines_angle(Chain(machine), rows, "X", "Y") == pytest.approx(3.0, abs=1e-3)
    assert squareness(machine, rows, "LARGER_THAN_90") == pytest.approx({"XZ": 5.0, "XY": 3.0, "YZ": 0.0})


def test_turning_a_carrier_leaves_the_angle_to_what_it_carries() -> None:
    """On "w X Y b Z t" EC0Y turns table X along with saddle Y, so the squareness of Y to X is EC0X, turned back."""
    machine = load_machine(preset("vmc3"))
    assert lines_angle(Chain(machine), [("EC0Y", None, 10.0)], "X", "Y") == pytest.approx(0.0, abs=1e-3)
    assert squareness_rows(machine, {"XY": 10.0}, "RIGHT_HANDED") == [("EC0X", None, -10.0)]
    assert squareness_rows(machine, {"XZ": 10.0}, "RIGHT_HANDED") == [("EB0Z", None, 10.0)]


@pytest.mark.parametrize("structure", ["w C b X Y Z t", "w C X b Y Z t", "w C A Y X b Z t"])
def test_the_place_of_a_rotary_table_keeps_its_sign(structure: str) -> None:
    """EX0C = 10 µm: C's line lies 10 µm in +X, so the tip stands still on the turning table at X = 0.010."""
    machine = parse_machine(
        f'name = "t"\nstructure = "{structure}"\n'
        + "".join(f"[axes.{a}]\nrange = [-360, 360]\n" for a in "XYZAC" if a in structure)
    )
    rows: list[Row] = [("EX0C", None, 10.0)]
    assert to_body(machine, rows) == rows
    q = np.zeros((5, len(machine.axis_names)))
    q[:, 0] = 0.010
    q[:, machine.axis_names.index("C")] = np.linspace(0, 300, 5)
    e = ErrorMap.from_rows(machine, rows).evaluate(q)
    np.testing.assert_allclose(Chain(machine).tip(q, e), 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("structure", "term", "turns"),
    [
        ("w C X b Y Z t", "EXX", True),
        ("w C X b Y Z t", "EAX", True),
        ("w C X b Y Z t", "EX0X", True),  # a zero offset: the table too far, the tool behind
        ("w C X b Y Z t", "EA0X", True),  # a roll of the table about its own line
        ("w C X b Y Z t", "EC0X", False),  # squareness
        ("w C X b Y Z t", "EXC", True),
        ("w C X b Y Z t", "EX0C", False),  # where C's line lies
        ("w C X b Y Z t", "EB0C", False),  # how it is tilted
        ("w C X b Y Z t", "EZ0C", True),  # along the line: the table too high
        ("w C X b Y Z t", "EC0C", True),  # zero of C
        ("w C X b Y Z t", "EX0W", True),  # fixture
        ("w C X b Y Z t", "EX0T", False),
        ("w b X Y Z C t", "EXX", False),
        ("w b X Y Z C t", "EC0C", False),
    ],
)
def test_which_terms_turn_their_sign(structure: str, term: str, turns: bool) -> None:
    text = machine_text(structure).replace("[tool]", "[axes.C]\nrange = [-360.0, 360.0]\n[tool]")
    machine = parse_machine(text)
    assert turns_sign(machine, machine.term(term)) is turns
    seeds = parse_machine(text.replace('"motion-last"', '"seed"'))
    on_the_workpiece_side = machine.bodies[machine.term(term).body].side < 0
    assert turns_sign(seeds, seeds.term(term)) is on_the_workpiece_side


def test_wrong_tables_get_one_sentence() -> None:
    machine = parse_machine(machine_text("w X Y b Z t"))
    with pytest.raises(DataError, match="error table, row 1: unknown error term 'EXQ'"):
        to_body(machine, [("EXQ", None, 1.0)])
    with pytest.raises(DataError, match="functional point of axis 'Q': machine 'test' has no axis 'Q'; known are"):
        to_body(machine, [], {"Q": FunctionalPoint()})
    with pytest.raises(DataError, match="functional point of axis 'X': machine 'test' has no axis 'B'; known are"):
        to_tool(machine, [], {"X": FunctionalPoint({"B": 3.0})})
    for pair in ("XX", "XQ", "X", "XYZ"):
        with pytest.raises(DataError, match=f"squareness '{pair}' must name two of the axes X, Y, Z at right angles"):
            squareness_rows(machine, {pair: 1.0}, "RIGHT_HANDED")
    slanted = machine_text("w Y b X Z t").replace("[axes.Y]", "[axes.Y]\ndirection = [0.0, -0.8, 0.6]")
    with pytest.raises(DataError, match="EB0Y is oblique to axis Y, so only a part of it changes sign|EC0Y is oblique"):
        to_body(parse_machine(slanted), [("EC0Y", None, 1.0)])
    assert list(squareness(parse_machine(slanted), [], "RIGHT_HANDED")) == ["XZ"]
    with pytest.raises(DataError, match="squareness of machine 'seed3' must go into its straightness terms"):
        squareness_rows(load_machine(preset("seed3")), {"XY": 1.0}, "RIGHT_HANDED")


def test_what_carries_tool_and_workpiece_cannot_be_measured_between_them() -> None:
    text = 'name = "t"\n'
    for name, lower, axis in (("bed", "", ""), ("slide", "bed", "X"), ("head", "slide", "Z")):
        text += f'[[bodies]]\nname = "{name}"\n' + (f'lower = "{lower}"\naxis = "{axis}"\n' if lower else "")
    text += '[[bodies]]\nname = "workpiece"\nlower = "slide"\n[[bodies]]\nname = "tool"\nlower = "head"\n'
    machine = parse_machine(text + "[axes.X]\nrange = [0, 9]\n[axes.Z]\nrange = [0, 9]\n")
    with pytest.raises(DataError, match="EYX must be of what moves the tool against the workpiece, but body 'slide'"):
        to_body(machine, [("EYX", 0.0, 1.0)])
