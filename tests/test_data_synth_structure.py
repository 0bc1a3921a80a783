"""Laws of every structure in the shop: they hold for any machine, whatever its constants."""

import numpy as np
import pytest

from data_synth.joints import rotations
from data_synth.machines import DESIGNS, open_shop
from data_synth.tip import tip_deviation
from model.chain import Chain
from model.transforms import apply, apply_inverse, exact_error

ANGLES = slice(3, 6)
MACHINES = tuple(DESIGNS)


@pytest.fixture(scope="module", params=MACHINES)
def shop(request):
    return open_shop(request.param)


def alphas(shop):
    """Return the smallest and the largest coefficient of expansion of what the machine is made of."""
    structure = shop.design.structure
    found = [part.beam.expansion_per_K for parts in structure.bodies.values() for part in parts.values()]
    found += [drive.expansion_per_K for joint in structure.joints.values() for drive in getattr(joint, "drives", ())]
    return min(found), max(found)


def one_kelvin(shop):
    return shop.fields.evaluate(np.ones((1, len(shop.design.network.nodes))), np.zeros(1))


def test_a_uniform_rise_turns_nothing(shop):
    got = one_kelvin(shop)
    for values in (*got.motion.values(), *got.location.values()):
        np.testing.assert_allclose(values[:, ANGLES], 0.0, atol=1e-7)


def test_a_uniform_rise_lengthens_every_axis_by_alpha_times_length(shop):
    got, machine = one_kelvin(shop), shop.machine
    low, high = alphas(shop)
    for name, axis in machine.axes.items():
        if axis.rotary:
            # A rotary axis' own body is as warm all around: nothing comes once per turn but what does not grow.
            np.testing.assert_allclose(np.ptp(got.motion[name], axis=2), 0.0, atol=1e-9)
            continue
        motion = got.motion[name][0]
        along = int(np.argmax(np.abs(axis.direction)))
        slope = np.diff(motion[along]) / np.diff(got.positions[name]) * axis.direction[along]
        np.testing.assert_allclose(slope, slope[0], rtol=1e-6)
        assert 1e3 * low * (1 - 1e-9) <= slope[0] <= 1e3 * high * (1 + 1e-9)
        across = [k for k in range(3) if k != along]
        np.testing.assert_allclose(np.ptp(motion[across], axis=1), 0.0, atol=1e-9)


def test_the_terms_put_the_tip_where_the_displaced_bodies_do(shop):
    """Frames shifted and turned as the structure says, against the exact chain with the split terms.

    For small errors, since the two differ by products of two of them.
    """
    machine, fields, n = shop.machine, shop.fields, 20
    rng = np.random.default_rng(5)
    node = shop.design.network.index()
    causes = {**node, **{bend.name: len(node) + k for k, bend in enumerate(fields.bends)}}
    # Some 0.03 K, and a bend's causes are in mm.
    amount = np.concatenate([rng.normal(0.03, 0.03, len(node)), rng.normal(0.0, 1e-4, len(fields.bends))])
    places = {name: rng.integers(0, len(p), n) for name, p in fields.positions.items()}
    q = np.column_stack([fields.positions[name][places[name]] for name in machine.axis_names])
    paths, leaves = shop.design.structure.displaced(machine, causes)

    def small(displacement):
        return exact_error(np.concatenate([displacement.shift @ amount, displacement.turn @ amount], axis=1))

    frames = {0: np.tile(np.eye(4), (n, 1, 1))}
    for index, body in enumerate(machine.bodies[1:], start=1):
        lower = frames[body.lower]
        if body.axis is None:
            frames[index] = lower @ (small(leaves[body.suffix]) if body.suffix else np.eye(4))
            continue
        axis, position = machine.axes[body.axis], q[:, machine.axis_names.index(body.axis)]
        frame = np.tile(np.eye(4), (n, 1, 1))
        frame[:, :3, :3] = rotations(axis, position)
        frame[:, :3, 3] = axis.origin_mm + np.outer(0.0 * position if axis.rotary else position, axis.direction)
        moved = small(paths[body.axis](position))
        frame[:, :3, :3] = moved[:, :3, :3] @ frame[:, :3, :3]
        frame[:, :3, 3] += moved[:, :3, 3]
        frames[index] = lower @ frame
    tip = apply(frames[machine.layout.tools["tool"]], np.array(machine.tool.offset_mm))
    direct = apply_inverse(frames[machine.layout.workpiece], tip) - Chain(machine).tip(q)

    e = np.zeros((n, len(machine.terms)))
    for k, term in enumerate(machine.terms):
        row = "XYZABC".index(term.direction)
        if term.kind == "motion":
            maps = np.concatenate([fields.motion[term.axis], fields.bend_motion[term.axis]], axis=2)
            e[:, k] = maps[row][places[term.axis]] @ amount
        else:
            maps = np.concatenate([fields.location[term.axis], fields.bend_location[term.axis]], axis=1)
            e[:, k] = maps[row] @ amount
    by_terms = Chain(machine).deviation(q, e).position_mm
    assert np.abs(direct).max() > 1e-4
    np.testing.assert_allclose(by_terms, direct, atol=1e-5 * np.abs(direct).max())


def test_every_location_and_motion_term_of_the_machine_is_given(shop):
    field = np.random.default_rng(3).normal(0.0, 3.0, (2, len(shop.design.network.nodes)))
    heads, values = shop.fields.evaluate(field, np.zeros(2)).columns(shop.machine)
    assert list(dict.fromkeys(name for name, _ in heads)) == [term.name for term in shop.machine.terms]
    assert values.shape == (2, len(heads))
    assert np.isfinite(values).all()


def test_a_rotary_axis_has_a_position_at_least_every_thirty_degree(shop):
    for name, axis in shop.machine.axes.items():
        if axis.rotary:
            assert np.diff(shop.fields.positions[name]).max() <= 30.0 + 1e-9


@pytest.mark.parametrize(("name", "table"), [("hmc4", "B"), ("trunnion5", "C")])
def test_the_tip_is_looked_at_in_places_that_show_a_turned_table(name, table):
    """A table's line out of place by 1 µm, its workpiece's frame turning: seen from there the error turns too."""
    shop = open_shop(name)
    none = shop.fields.evaluate(np.zeros((1, len(shop.design.network.nodes))), np.zeros(1))
    none.location[table][0, 0] = 1.0
    seen = tip_deviation(shop.machine, none)[0]
    np.testing.assert_allclose(np.linalg.norm(seen, axis=1), 1.0, atol=1e-9)
    assert len(np.unique(np.round(seen, 6), axis=0)) == 3
