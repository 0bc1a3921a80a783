"""Cold errors of any machine the presets know."""

from importlib import resources

import numpy as np
import pytest

from data_synth.geometric import NORMAL, geometry
from data_synth.joints import LinearJoint
from data_synth.machines import DESIGNS
from data_synth.screw import Screw
from model.machine import load_machine, preset
from model.term_classes import squareness_terms

PRESETS = sorted(
    path.name[:-5] for path in (resources.files("model") / "presets").iterdir() if path.name.endswith(".toml")
)


def tables(name, seed=0):
    """Return the machine and each term's positions and values."""
    machine = load_machine(preset(name))
    found: dict[str, tuple[list, list]] = {}
    for row in geometry(machine, np.random.default_rng(seed)):
        at, values = found.setdefault(row.term, ([], []))
        at.append(row.position)
        values.append(row.value)
    return machine, {term: (at, np.array(values)) for term, (at, values) in found.items()}


@pytest.mark.parametrize("name", PRESETS)
def test_every_term_has_a_table_over_the_range_of_its_axis(name):
    machine, got = tables(name)
    assert list(got) == [term.name for term in machine.terms]
    for term in machine.terms:
        at, values = got[term.name]
        if term.kind == "location":
            assert at == [None]
            continue
        axis = machine.axes[term.axis]
        assert (at[0], at[-1]) == (axis.low, axis.high)
        assert np.isfinite(values).all()
        if axis.rotary:
            assert np.diff(at).max() <= NORMAL.step_degree + 1e-6


@pytest.mark.parametrize("name", DESIGNS)
def test_a_screws_error_once_a_turn_is_in_the_table_and_a_scale_has_none(name):
    machine, quality = load_machine(preset(name)), DESIGNS[name].workmanship
    sizes: dict[str, list] = {}
    for seed in range(8):
        rows = geometry(machine, np.random.default_rng(seed), quality)
        for axis in "XYZ":
            at, values = np.array([(r.position, r.value) for r in rows if r.term == f"E{axis}{axis}"]).T
            screw = axis not in quality.without_screw
            angle = 2.0 * np.pi * at / quality.pitch_mm
            smooth = (at - at.mean()) / (at[-1] - at[0])
            waves = [f(k * angle) for k in (1, 2) for f in (np.sin, np.cos)] if screw else []
            basis = np.column_stack([*(smooth**k for k in range(6)), *waves])
            fit = np.linalg.lstsq(basis, values, rcond=None)[0]
            np.testing.assert_allclose(basis @ fit, values, atol=1e-3)  # so nothing else is in it
            if screw:
                assert np.diff(at).max() <= quality.pitch_mm / 8 + 1e-9
                sizes.setdefault(axis, []).append(once := np.hypot(*fit[6:8]))
                assert np.hypot(*fit[8:]) == pytest.approx(0.3 * once, abs=1e-3)
    assert set(sizes) == set("XYZ") - set(quality.without_screw)
    for once in sizes.values():
        assert 0.3 < np.mean(once) / quality.pitch_um < 1.5


@pytest.mark.parametrize("name", DESIGNS)
def test_the_axes_said_to_be_without_a_screw_are_those_whose_drives_are_none(name):
    linear = {axis: joint for axis, joint in DESIGNS[name].structure.joints.items() if isinstance(joint, LinearJoint)}
    screwed = {axis for axis, joint in linear.items() if any(isinstance(drive, Screw) for drive in joint.drives)}
    assert set(linear) - screwed == set(DESIGNS[name].workmanship.without_screw)


@pytest.mark.parametrize(("name", "axis", "along"), [("trunnion5", "C", "ZC"), ("hmc4", "B", "YB")])
def test_a_rotary_axis_repeats_each_turn_and_has_no_run_out_of_its_own_line(name, axis, along):
    _, got = tables(name)
    for direction in "XYZABC":
        at, values = got[f"E{direction}{axis}"]
        turn = (np.array(at) >= -360.0) & (np.array(at) < 0.0)
        one = values[turn]
        np.testing.assert_allclose(one, values[np.flatnonzero(turn) + len(one)], atol=2e-4)
        harmonics = np.abs(np.fft.rfft(one)) / len(one)
        assert harmonics.max() > 0.05
        if direction not in along:
            np.testing.assert_allclose(harmonics[:2], 0.0, atol=1e-4)
        np.testing.assert_allclose(harmonics[5:], 0.0, atol=1e-4)


def test_in_the_seeds_composition_squareness_is_the_slope_of_straightness():
    _, got = tables("seed3")
    slopes = {f"E{d}{a}": np.polyfit(*got[f"E{d}{a}"], 1)[0] * 1e3 for a in "XYZ" for d in "XYZ" if d != a}
    # What a turn by EC0X, EA0Z, EB0Z does to X and Z; beside it, a polynomial has a small slope of its own.
    wanted = {"EYX": got["EC0X"][1][0], "EXZ": got["EB0Z"][1][0], "EYZ": -got["EA0Z"][1][0]}
    straight = tables("vmc3")[1]
    own = max(abs(np.polyfit(*straight[name], 1)[0]) * 1e3 for name in slopes)
    for name, slope in slopes.items():
        assert slope == pytest.approx(wanted.get(name, 0.0), abs=max(5.0, 2.0 * own))
    assert max(abs(value) for value in wanted.values()) > 10.0


def test_in_the_seeds_composition_secondary_location_terms_are_small():
    ratios = []
    for seed in range(20):
        machine, got = tables("seed3", seed)
        square = squareness_terms(machine)
        values = {t.name: got[t.name][1][0] for t in machine.terms if t.kind == "location"}
        secondary = [v for name, v in values.items() if name not in square]
        motion = np.concatenate([got[t.name][1] for t in machine.terms if t.kind == "motion"])
        ratios.append(np.sqrt(np.mean(np.square(secondary)) / np.mean(np.square(motion))))
    assert 1e-3 < np.mean(ratios) < 1e-2


def test_a_machine_of_the_same_seed_is_the_same_and_of_another_is_not():
    machine = load_machine(preset("trunnion5"))
    first, again, other = (geometry(machine, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first == again
    assert first != other
