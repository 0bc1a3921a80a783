import numpy as np
import pytest

from data_synth.beam import Beam, Section
from data_synth.displacement import Displacement
from data_synth.guide import split
from data_synth.machines import open_shop
from data_synth.materials import CAST_IRON, STEEL
from data_synth.tip import tip_deviation
from data_synth.vmc3_structure import SCREW_X, SCREW_Z

ANGLES = slice(3, 6)
NODE = {f"{end}{corner}": 4 * e + c for e, end in enumerate("ab") for c, corner in enumerate("0123")}
CORNERS = [(x, 0.0, z) for x in (-100.0, 100.0) for z in (-50.0, 150.0)]
ALPHA = 11e-6
BEAM = Beam(
    origin_mm=(10.0, -20.0, 30.0),
    along=(0.0, 1.0, 0.0),
    sections=tuple(
        Section(at, {f"{end}{c}": CORNERS[c] for c in range(4)}) for end, at in (("a", -300.0), ("b", 400.0))
    ),
    expansion_per_K=ALPHA,
)
SHOP = open_shop("vmc3")
NODES = SHOP.design.network.nodes


def terms(**rise):
    """Return the terms where nodes whose name begins so are this much warmer."""
    field = np.array([[sum(k for start, k in rise.items() if name.startswith(start)) for name in NODES]], float)
    return SHOP.fields.evaluate(field, np.zeros(1))


def beam_temperatures(field):
    """Return a temperature field's values at the beam's nodes."""
    places = [
        np.add(BEAM.origin_mm, np.add((0.0, section.at_mm, 0.0), offset))
        for section in BEAM.sections
        for offset in section.nodes.values()
    ]
    return np.array([field(place) for place in places])


@pytest.mark.parametrize("gradient", [(0, 0, 0), (0.01, 0, 0), (0, 0.004, 0), (0, 0, -0.02), (0.01, 0.004, -0.02)])
def test_a_linear_temperature_field_deforms_without_stress(gradient):
    """u = α [θ x + (g·x) x - g x²/2], ω = α g × x from where nothing moves (Boley and Weiner)."""
    g, origin = np.array(gradient), np.array(BEAM.origin_mm)
    rise = beam_temperatures(lambda p: 3.0 + g @ (p - origin))
    points = origin + np.random.default_rng(0).uniform(-250.0, 250.0, (20, 3))
    if g[1]:  # sections stay plane: a gradient along the axis is exact on the axis
        points[:, [0, 2]] = origin[[0, 2]]
    got = BEAM.displacement(points, origin, NODE)
    x = points - origin
    wanted = ALPHA * (3.0 * x + (x @ g)[:, None] * x - 0.5 * (x**2).sum(1)[:, None] * g)
    np.testing.assert_allclose(got.shift @ rise, wanted, atol=1e-15)
    np.testing.assert_allclose(got.turn @ rise, ALPHA * np.cross(g, x), atol=1e-18)


def test_straightness_has_its_slope_as_angle():
    rise = np.random.default_rng(1).normal(0.0, 5.0, len(NODE))
    s = np.linspace(-300.0, 400.0, 2001)
    axis = np.array(BEAM.origin_mm) + s[:, None] * np.array(BEAM.along)
    got = BEAM.displacement(axis, axis[700], NODE)
    slope = np.gradient(got.shift @ rise, s, axis=0)[1:-1]
    turn = (got.turn @ rise)[1:-1]
    np.testing.assert_allclose(slope[:, 2], turn[:, 0], atol=1e-10)  # ω × y
    np.testing.assert_allclose(slope[:, 0], -turn[:, 2], atol=1e-10)


def test_a_beams_anchor_stays_where_it_is():
    anchor = (40.0, 120.0, -10.0)
    got = BEAM.displacement([anchor], anchor, NODE)
    np.testing.assert_allclose(got.shift, 0.0, atol=1e-18)
    np.testing.assert_allclose(got.turn, 0.0, atol=1e-21)


@pytest.mark.parametrize("screw", [SCREW_X, SCREW_Z])
def test_a_screws_nut_moves_by_the_integral_of_strain(screw):
    """∫ α (a + b s) ds from the fixed bearing to the nut, between the outer nodes, where linear stays linear."""
    node = {name: i for i, name in enumerate(screw.nodes)}
    centres = np.array(screw.centres_mm)
    a, b = 4.0, 0.013
    nut = np.linspace(centres[0], centres[-1], 50)
    got = screw.nut_shift(nut, node) @ (a + b * centres)

    def primitive(s):
        return screw.expansion_per_K * (a * s + 0.5 * b * s**2)

    np.testing.assert_allclose(got - got[0], primitive(nut) - primitive(nut[0]), atol=1e-15)
    assert abs((screw.nut_shift(np.array([screw.fixed_mm]), node) @ centres)[0]) < 1e-15


def test_a_stretched_screw_yields_until_its_stretch_is_used_up():
    stretch = SCREW_X.expansion_per_K * SCREW_X.stretch_K * 1240.0
    growth = np.linspace(-3.0, 6.0, 400) * stretch
    got = SCREW_X.relief(growth)
    assert SCREW_X.relief(np.zeros(1))[0] == 0.0
    assert (np.diff(got) > 0.0).all()
    slope = np.gradient(got, growth)
    np.testing.assert_allclose(slope[[0, -2]], [SCREW_X.held, 0.0], atol=1e-3)
    np.testing.assert_array_equal(SCREW_Z.relief(growth), 0.0)


def test_location_and_motion_terms_make_up_the_path():
    rng = np.random.default_rng(2)
    shift, turn = rng.normal(size=(2, 4, 3, 5))

    def path(p):
        powers = (p[:, None] / 400.0 - 1.0) ** np.arange(4)
        return Displacement(np.tensordot(powers, shift, 1), np.tensordot(powers, turn, 1))

    at, d = np.linspace(0.0, 800.0, 9), np.array([0.0, -1.0, 0.0])
    got = split(path, (0.0, -1.0, 0.0), (0.0, 800.0), at)
    for k in range(5):
        x0, w0 = got.location[:3, k], got.location[ANGLES, k]
        whole = x0 + np.cross(w0, at[:, None] * d) + got.motion[:3, :, k].T
        np.testing.assert_allclose(whole, path(at).shift[..., k], atol=1e-12)
        np.testing.assert_allclose(w0 + got.motion[ANGLES, :, k].T, path(at).turn[..., k], atol=1e-12)


def test_a_straight_oblique_path_is_location_alone():
    def path(p):
        line = np.stack([2.0 + 3e-3 * p, 0.0 * p, -1.0 + 5e-3 * p], axis=1)[..., None]
        turn = np.cross(np.array([0.0, 1.0, 0.0]), [3e-3, 0.0, 5e-3])
        return Displacement(line, np.tile(turn[:, None], (len(p), 1, 1)))

    got = split(path, (0.0, 1.0, 0.0), (0.0, 500.0), np.linspace(0.0, 500.0, 9))
    np.testing.assert_allclose(got.motion, 0.0, atol=1e-12)
    np.testing.assert_allclose(got.location[:, 0], [2.0, 0.0, -1.0, 5e-3, 0.0, -3e-3], atol=1e-12)


def test_a_uniform_rise_is_pure_expansion():
    got = terms(**{"": 1.0})
    for values in (*got.motion.values(), *got.location.values()):
        np.testing.assert_allclose(values[:, ANGLES], 0.0, atol=1e-9)
    for k, (axis, sign) in enumerate((("X", -1), ("Y", -1), ("Z", 1))):
        across = [j for j in range(3) if j != k]
        np.testing.assert_allclose(got.motion[axis][:, across], 0.0, atol=1e-9)
        slope = np.diff(got.motion[axis][0, k]) / np.diff(got.positions[axis])
        np.testing.assert_allclose(slope, slope[0], rtol=1e-9)
        if axis == "Z":  # the free screw; the stretched ones yield to the difference between steel and iron
            assert slope[0] == pytest.approx(1e3 * sign * STEEL.expansion_per_K)
        assert 1e3 * CAST_IRON.expansion_per_K < slope[0] * sign <= 1e3 * STEEL.expansion_per_K + 1e-12


def test_a_uniform_rise_lifts_the_nose_from_the_table_as_a_gauge_block_would_grow():
    got = tip_deviation(SHOP.machine, terms(**{"": 1.0}))[0]
    per_mm = got[-1] / np.array([800.0, 500.0, 650.0])  # nose over table's corner: X, Y, Z + 150
    assert (per_mm > 0.8e3 * CAST_IRON.expansion_per_K).all()
    assert (per_mm < 1.2e3 * STEEL.expansion_per_K).all()


def forbidden(got):
    """Return what a machine that is symmetric about its x plane cannot have."""
    motion = [got.motion[axis][:, row] for axis in "YZ" for row in (0, 4, 5)]
    location = [got.location[body][:, row] for body in "YZT" for row in (0, 4, 5)]
    return np.concatenate([values.ravel() for values in motion + location])


def test_symmetric_warmth_leaves_symmetric_terms_zero():
    symmetric = terms(column_upper=4.0, bed_front=-2.0, head_front=7.0, spindle=20.0, screw=5.0, bed_rear_base=3.0)
    np.testing.assert_allclose(forbidden(symmetric), 0.0, atol=1e-9)
    assert np.abs(symmetric.location["Z"][0, 3]) > 1.0  # while pitch is there


@pytest.mark.parametrize("part", ["column_upper", "bed_front", "head_front"])
def test_one_warm_side_breaks_the_symmetry_and_the_other_mirrors_it(part):
    left, right = (forbidden(terms(**{f"{part}_{side}": 3.0})) for side in ("left", "right"))
    assert np.abs(left).max() > 0.1
    np.testing.assert_allclose(left, -right, atol=1e-9)


def test_a_warm_spindle_pushes_its_nose_down():
    assert terms(spindle=20.0).location["T"][0, 2] == pytest.approx(-20e3 * 180.0 * STEEL.expansion_per_K)


def test_the_nose_moves_with_the_square_of_speed():
    cold = np.zeros((3, len(NODES)))
    shift = SHOP.fields.evaluate(cold, np.array([0.0, 6000.0, 12000.0])).location["T"][:, 2]
    np.testing.assert_allclose(shift, [0.0, -1.0, -4.0])  # out of the head, which points down


def test_every_term_is_alive():
    field = np.random.default_rng(3).normal(0.0, 3.0, (1, len(NODES)))
    heads, values = SHOP.fields.evaluate(field, np.zeros(1)).columns(SHOP.machine)
    assert list(dict.fromkeys(name for name, _ in heads)) == [t.name for t in SHOP.machine.terms]
    for term in SHOP.machine.terms:
        assert max(abs(v) for (name, _), v in zip(heads, values[0], strict=True) if name == term.name) > 1e-3, term
