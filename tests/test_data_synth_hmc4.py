import numpy as np
import pytest
from warming import warming

from data_synth import cycles
from data_synth.building_blocks import Rod, screw_links
from data_synth.hmc4_structure import SCREW_X
from data_synth.machines import open_shop
from data_synth.materials import CAST_IRON, STEEL
from data_synth.run import run_kind, run_name, simulate
from data_synth.summary import RunSummary
from data_synth.tip import tip_deviation

SHOP = open_shop("hmc4")
NODES = SHOP.design.network.nodes
IRON, ANGLES = 1e3 * CAST_IRON.expansion_per_K, slice(3, 6)  # µm per K and mm
KINDS = ("shop", "spindle", "axes", "rotary", "warmup", "coolant", "breaks", "etve")
SADDLE = [NODES.index(f"saddle_{end}_{side}") for end in ("front", "rear") for side in ("left", "right")]


def terms(**rise):
    """Return the terms where nodes whose name begins so are this much warmer."""
    field = np.array([[sum(k for start, k in rise.items() if name.startswith(start)) for name in NODES]], float)
    return SHOP.fields.evaluate(field, np.zeros(1))


@pytest.fixture(scope="module")
def runs():
    return [simulate(SHOP, kind, kind, (7, i), 12.0) for i, kind in enumerate(KINDS)]


def test_every_node_is_linked_and_every_source_lands():
    linked = {end for link in SHOP.design.network.links for end in (link.a, link.b)}
    assert linked == {*NODES, *SHOP.design.network.boundaries}
    warmed = {name for source in SHOP.design.sources for name in getattr(source, "onto", {})}
    assert warmed <= set(NODES)
    for source in SHOP.design.sources:
        if shares := getattr(source, "onto", {}):
            assert sum(shares.values()) <= 1.0 + 1e-12, source


def test_a_rod_has_the_mass_and_the_surface_of_its_number():
    assert Rod(40.0).kg_per_m == pytest.approx(9.86, abs=0.01)  # 7850 kg/m³ times 12.57 cm²
    assert Rod(40.0, number=2).kg_per_m == pytest.approx(2 * Rod(40.0).kg_per_m)
    assert Rod(40.0, number=2).girth_m == pytest.approx(2 * Rod(40.0).girth_m)


def test_a_screws_links_hold_it_together_and_join_its_motor_at_the_end_that_was_named():
    for end in (0, -1):
        links = screw_links(SCREW_X, Rod(50.0), {"bed": 3.0}, {"table": 2.0}, "air_high", end)
        ends = {link.b: link.a for link in links if link.b == "motor_x"}
        assert ends == {"motor_x": SCREW_X.nodes[end]}
        assert len([k for k in links if {k.a, k.b} <= set(SCREW_X.nodes)]) == len(SCREW_X.nodes) - 1


def test_a_uniform_rise_turns_nothing_and_lifts_the_nose_from_the_pallet_as_a_gauge_block_would_grow():
    got = terms(**{"": 1.0})
    for values in (*got.motion.values(), *got.location.values()):
        np.testing.assert_allclose(values[:, ANGLES], 0.0, atol=1e-9)
    np.testing.assert_allclose(got.motion["B"], 0.0, atol=1e-9)
    moved = tip_deviation(SHOP.machine, got)[0].reshape(3, 3, 3, 3, 3)  # X, Y, Z, B, direction
    for axis, length in enumerate((800.0, 700.0, 750.0)):
        front, far = np.take(moved, 0, axis), np.take(moved, 2, axis)
        per_mm = (far[..., axis] - front[..., axis])[..., 1] / length  # at B = 0
        assert (per_mm > IRON - 1e-9).all()  # screws of steel, some of them stretched, in iron
        assert (per_mm < 1.1 * 1e3 * STEEL.expansion_per_K).all()


def test_mirrored_warmth_makes_mirrored_terms():
    """The machine is symmetric about x = 0, but the X screw has its fixed bearing and the worm its side.

    How a bearing's rings run out is no matter of symmetry; here they are as warm as each other.
    """
    field = np.random.default_rng(5).normal(0.0, 3.0, len(NODES))
    field[NODES.index("bearing_b")] = field[SADDLE].mean()
    swap = {"left": "right", "right": "left"}
    twin = ["_".join(swap.get(part, part) for part in name.split("_")) for name in NODES]
    mirrored = field[[NODES.index(name) for name in twin]]
    one, other = (SHOP.fields.evaluate(rise[None], np.zeros(1)) for rise in (field, mirrored))
    sign = np.array([-1.0, 1.0, 1.0, 1.0, -1.0, -1.0])
    for body in "YZTX":
        rows = slice(1, 6) if body == "X" else slice(6)
        np.testing.assert_allclose((sign * one.location[body][0])[rows], other.location[body][0][rows], atol=1e-9)
    rows = [0, 1, 2, 3, 5]
    np.testing.assert_allclose((sign * one.location["B"][0])[rows], other.location["B"][0][rows], atol=1e-9)
    for axis in "YZ":
        np.testing.assert_allclose(sign[:, None] * one.motion[axis][0], other.motion[axis][0], atol=1e-9)
    np.testing.assert_allclose((sign[:, None] * one.motion["X"][0])[1:], other.motion["X"][0][1:, ::-1], atol=1e-9)
    np.testing.assert_allclose(sign[:, None] * one.motion["B"][0], other.motion["B"][0][:, ::-1], atol=1e-9)


def test_symmetric_warmth_leaves_forbidden_terms_zero():
    got = terms(column_upper=4.0, column_lower_front=2.0, bed=-2.0, head_front_upper=7.0, spindle=20.0, saddle=5.0)
    for body in "YZT":
        np.testing.assert_allclose(got.location[body][0, [0, 4, 5]], 0.0, atol=1e-9)
    for axis in "YZ":
        np.testing.assert_allclose(got.motion[axis][0, [0, 4, 5]], 0.0, atol=1e-9)
    assert abs(got.location["Y"][0, 3]) > 1.0  # while pitch is there


def test_a_column_with_a_warm_front_bends_to_the_rear_with_the_radius_of_its_gradient():
    """dω/ds = α ΔT / h: 2 K between walls 400 mm apart."""
    got = terms(column_lower_front=2.0, column_upper_front=2.0)
    at = got.positions["Y"]
    wanted = 1e6 * CAST_IRON.expansion_per_K * 2.0 / 400.0
    np.testing.assert_allclose(np.diff(got.motion["Y"][0, 3]) / np.diff(at), wanted, rtol=1e-9)
    straight = got.motion["Y"][0, 2]  # z of the path, with ω as its slope
    np.testing.assert_allclose(np.diff(straight, 2) / np.diff(at)[0] ** 2, 1e-3 * wanted, rtol=1e-6)


def test_a_warm_spindle_pushes_its_nose_out_of_the_head_and_a_warm_table_lifts_its_pallet():
    assert terms(spindle=20.0).location["T"][0, 2] == pytest.approx(-20e3 * 170.0 * STEEL.expansion_per_K)
    # Table from bearing to pallet, -320 to -130 mm; pallet up to its face.
    assert terms(table=10.0).location["B"][0, 1] == pytest.approx(10.0 * IRON * 190.0)
    assert terms(pallet=10.0).location["B"][0, 1] == pytest.approx(10.0 * IRON * 130.0)


def test_a_worm_wheel_that_is_warmer_than_its_housing_turns_the_table():
    warm, both = terms(worm_b=5.0, table=5.0), terms(worm_b=5.0, table=5.0, saddle=5.0)
    assert 5.0 < abs(warm.location["B"][0, 4]) < 60.0
    assert abs(both.location["B"][0, 4]) < 1e-9


def test_a_pallet_that_is_warm_on_one_side_errs_once_per_turn():
    """Its face tilts with it, so in its own frame it always errs alike, and in the saddle's it goes round."""
    got = terms(pallet_front=3.0)
    tilt = got.motion["B"][0, ANGLES]
    np.testing.assert_allclose(tilt[[0, 2]], tilt[[0, 2], :1] * np.ones(tilt.shape[1]), atol=1e-9)
    assert np.abs(tilt[0]).max() > 1.0
    moved = tip_deviation(SHOP.machine, got)
    assert np.abs(moved).max() > 1.0


def test_the_spindle_settles_in_an_hour_or_two_and_column_and_bed_over_a_shift():
    rise, end = warming(SHOP, 8000.0, 8.0)
    front, column, bed = (NODES.index(n) for n in ("spindle_front", "column_upper_front_left", "bed_stem_rear_left"))
    assert 5.0 < end[front] < 40.0
    assert rise[10, front] < 0.7 * end[front]
    assert rise[120, front] > 0.85 * end[front]
    assert rise[120, column] < 0.5 * end[column]
    assert 0.5 * end[column] < rise[480, column]
    assert rise[480, bed] < 0.8 * end[bed]


def test_drift_over_a_shift_is_of_the_size_that_tests_report(runs):
    """30 to 67 µm in machining centres (field.md, section 1a: UQAR, J. Exp. Theor. Anal. 2025 3(4):37; PSO-LSTM,
    Actuators 2025 14(12):567); furthest anywhere in the volume is more.
    """
    summaries = [RunSummary.of(run, tip_deviation(SHOP.machine, run.terms)) for run in runs]
    rms = np.array([summary.drift_um for summary in summaries])
    assert 15.0 < np.sqrt(np.mean(rms**2)) < 60.0
    assert 25.0 < np.median([s.furthest_um for s in summaries]) < 110.0
    assert max(s.furthest_um for s in summaries) < 250.0


def test_sensors_are_as_many_as_such_machines_carry_and_show_what_is_plausible(runs):
    assert 10 <= len(SHOP.machine.sensors) <= 16
    assert {"coolant", "ambient", "worm_b"} <= set(SHOP.machine.sensors)
    for name, sensor in SHOP.machine.sensors.items():
        shown = np.concatenate([run.sensors[name] for run in runs])
        assert sensor.range_degC[0] < shown.min()
        assert shown.max() < sensor.range_degC[1]
        assert max(np.abs(np.diff(run.sensors[name])).max() for run in runs) < sensor.max_rate_degC_per_min


def test_every_term_is_alive():
    field = np.random.default_rng(3).normal(0.0, 3.0, (1, len(NODES)))
    heads, values = SHOP.fields.evaluate(field, np.zeros(1)).columns(SHOP.machine)
    for term in SHOP.machine.terms:
        largest = max(abs(v) for (name, _), v in zip(heads, values[0], strict=True) if name == term.name)
        assert largest > 1e-3, term


def test_a_ring_warmer_than_its_saddle_makes_the_table_run_out_by_micrometres_and_no_more_after_a_turn():
    """A tenth of 420 mm times 5 K of steel: 2.4 µm, half of it more where both waves meet. Over half the diameter that
    is 12 µrad. Tables on rolling bearings run out by some micrometres, at worst 25 (Intellidrives, Accuracy vs Radial
    Runout).
    """
    got, twice = terms(bearing_b=5.0), terms(bearing_b=10.0)
    motion, at = got.motion["B"][0], got.positions["B"]
    size = 0.1 * 5e3 * STEEL.expansion_per_K * 420.0
    assert 0.9 * size < np.abs(motion[1]).max() <= 1.5 * size  # along its line
    leaning = np.hypot(1.0, 320.0 / 210.0)  # across it runs out itself and leans, 320 mm above
    assert size * leaning <= np.linalg.norm(motion[[0, 2]], axis=0).max() <= 1.5 * size * leaning + 1e-9
    assert np.abs(motion[[0, 2]]).max(axis=1).min() > size
    assert 1e3 * size / 210.0 <= np.linalg.norm(motion[[3, 5]], axis=0).max() <= 1.5e3 * size / 210.0 + 1e-9
    assert 2.0 < np.abs(motion[4]).max() < 25.0  # five arc seconds
    np.testing.assert_allclose(motion[:, at <= 0.0], motion[:, at >= 0.0], atol=1e-9)
    np.testing.assert_allclose(twice.motion["B"][0], 2.0 * motion, atol=1e-9)
    still = terms(bearing_b=5.0, saddle=5.0)
    np.testing.assert_allclose(still.motion["B"], 0.0, atol=1e-9)


def test_temperatures_tell_most_of_the_drift_but_not_all():
    """Published models remove 69 to 99 % (Ngoc, Machines 2023 11(4):496), linear ones 90 % (Wu and Kung 2005)."""
    order = cycles.order(SHOP.machine)
    many = [simulate(SHOP, run_name(i, order), run_kind(i, order), (5, i), 12.0) for i in range(24)]
    shown = [np.column_stack(list(run.sensors.values()))[::5] for run in many]
    tips = [tip_deviation(SHOP.machine, run.terms).reshape(len(run.terms_time_s), -1) for run in many]
    x, y, test_x, test_y = (np.vstack(part) for part in (shown[:18], tips[:18], shown[18:], tips[18:]))
    mean, scale = x.mean(0), x.std(0)
    a = (x - mean) / scale
    weights = np.linalg.solve(a.T @ a + 1e-3 * len(a) * np.eye(a.shape[1]), a.T @ (y - y.mean(0)))
    left = test_y - (test_x - mean) / scale @ weights - y.mean(0)
    assert 0.08 < np.sqrt(np.mean(left**2) / np.mean(test_y**2)) < 0.35
