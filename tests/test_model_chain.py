import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from machines import ARRANGEMENTS, machine_text

from model.chain import Chain
from model.machine import load_machine, parse_machine, preset
from model.structure import lower_body_array
from model.terms import DIRECTIONS

CHAINS = {(s, c): Chain(parse_machine(machine_text(s, c))) for s in ARRANGEMENTS for c in ("motion-last", "seed")}
chains = st.sampled_from(list(CHAINS.values()))
RNG = np.random.default_rng(2)


def positions(chain: Chain, n: int) -> np.ndarray:
    axes = [chain.machine.axes[a] for a in chain.machine.axis_names]
    return RNG.uniform([a.low for a in axes], [a.high for a in axes], (n, len(axes)))


def unit_errors(chain: Chain) -> st.SearchStrategy[np.ndarray]:
    return arrays(float, len(chain.machine.terms), elements=st.floats(-1, 1, width=32))


def test_seed_machine_has_the_papers_lower_body_array_and_36_terms() -> None:
    machine = load_machine(preset("seed3"))
    assert [b.name for b in machine.bodies] == ["bed", "Y", "X", "Z"]
    assert lower_body_array(machine.bodies) == [0, 1, 2, 1]
    assert len(machine.terms) == 36
    assert sum(t.kind == "motion" for t in machine.terms) == 18


def test_tool_and_workpiece_bodies_add_six_location_terms_each() -> None:
    machine = parse_machine(machine_text("w X Y b Z t"))
    assert len(machine.terms) == 36 + 12
    assert [t.name for t in machine.terms][-6:] == [f"E{d}0T" for d in DIRECTIONS]
    assert lower_body_array(machine.bodies) == [0, 1, 2, 3, 1, 5]


@pytest.mark.parametrize("structure", ARRANGEMENTS)
def test_iso_841_plus_moves_the_tool_in_plus_relative_to_the_workpiece(structure: str) -> None:
    chain = CHAINS[structure, "motion-last"]
    q = positions(chain, 4)
    start = chain.tip(q)
    for column in range(3):
        moved = q.copy()
        moved[:, column] += 7.0
        expected = np.zeros(3)
        expected[column] = 7.0
        np.testing.assert_allclose(chain.tip(moved) - start, np.tile(expected, (4, 1)), atol=1e-11)


@given(chains)
def test_no_errors_no_deviation(chain: Chain) -> None:
    q = positions(chain, 3)
    for form in ("exact", "small-angle"):
        found = chain.deviation(q, np.zeros(len(chain.machine.terms)), form=form)
        np.testing.assert_allclose(found.position_mm, 0.0, atol=1e-12)
        np.testing.assert_allclose(found.orientation_rad, 0.0, atol=1e-15)


@given(chains, st.data())
@settings(deadline=None)
def test_first_order_minus_exact_shrinks_as_the_square(chain: Chain, data: st.DataObject) -> None:
    e = data.draw(unit_errors(chain)) * 1e-2
    e[np.abs(e) < 1e-3] = 1e-3
    q = positions(chain, 2)
    gaps = []
    for scale in (1e-1, 1e-2):
        found = chain.deviation(q, scale * e)
        exact = np.concatenate([found.position_mm / 1000.0, found.orientation_rad], axis=1)
        linear = (chain.sensitivity(q) @ (scale * e)) / np.array([1000.0] * 3 + [1.0] * 3)
        gaps.append(np.linalg.norm(exact - linear))
    assert np.log10(gaps[0] / gaps[1]) == pytest.approx(2.0, abs=0.1)


@given(chains, st.data())
@settings(deadline=None)
def test_exact_deviation_is_minus_equation_8_in_the_erroneous_workpiece_frame(
    chain: Chain, data: st.DataObject
) -> None:
    """A rotation keeps lengths, so |E| is |deviation| whatever the frame."""
    e = data.draw(unit_errors(chain)) * 1e-2
    q = positions(chain, 3)
    size = np.linalg.norm(chain.deviation(q, e).position_mm, axis=1)
    np.testing.assert_allclose(np.linalg.norm(chain.seed_error(q, e, form="exact"), axis=1), size, atol=1e-10)


@pytest.mark.parametrize("structure", ARRANGEMENTS)
@pytest.mark.parametrize("composition", ["motion-last", "seed"])
def test_sensitivity_is_the_derivative(structure: str, composition: str) -> None:
    chain = CHAINS[structure, composition]
    q = positions(chain, 2)
    step = 1e-6
    sensitivity = chain.sensitivity(q)
    for k, term in enumerate(chain.machine.terms):
        e = np.zeros(len(chain.machine.terms))
        e[k] = step
        plus, minus = chain.deviation(q, e), chain.deviation(q, -e)
        slope = np.concatenate(
            [plus.position_mm - minus.position_mm, plus.orientation_rad - minus.orientation_rad], axis=1
        ) / (2 * step)
        np.testing.assert_allclose(slope, sensitivity[:, :, k], atol=2e-5, err_msg=term.name)


@pytest.mark.parametrize(
    ("structure", "term", "expected"),
    [
        # Tool side: the head 10 µm too far in +X puts the tip 10 µm in +X.
        ("w b X Y Z t", "EXX", [10.0, 0.0, 0.0]),
        # Workpiece side: the table 10 µm too far in +X leaves the tip 10 µm behind in -X.
        ("w X b Y Z t", "EXX", [-10.0, 0.0, 0.0]),
        # The tool holder 10 µm up is the tip 10 µm up.
        ("w X Y b Z t", "EZ0T", [0.0, 0.0, 10.0]),
        # Fixture drift has the opposite sign.
        ("w X Y b Z t", "EX0W", [-10.0, 0.0, 0.0]),
        # Tilt of the tool holder about +Y by 10 µrad, tip at (1, 2, -150): 10e-6 * (-150, 0, -1) mm.
        ("w X Y b Z t", "EB0T", [-1.5, 0.0, -0.01]),
    ],
)
def test_single_terms_against_hand_worked_deviations(structure: str, term: str, expected: list[float]) -> None:
    chain = CHAINS[structure, "motion-last"]
    machine = chain.machine
    e = np.zeros(len(machine.terms))
    e[machine.term_index[term]] = 10 * machine.term(term).to_internal
    found = chain.deviation(np.array([[100.0, 50.0, 200.0]]), e).position_mm[0] * 1e3
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_squareness_turns_the_motion_last_and_not_in_the_seeds_composition() -> None:
    """EC0X of a tool-side X by +10 µrad: at X = 400 the tip is 4 µm further in +Y than at X = 0."""
    for composition, expected in (("motion-last", 4.0), ("seed", 0.0)):
        chain = CHAINS["w Y b X Z t", composition]
        e = np.zeros(len(chain.machine.terms))
        e[chain.machine.term_index["EC0X"]] = 10e-6
        found = chain.deviation(np.array([[0.0, 0.0, 0.0], [400.0, 0.0, 0.0]]), e).position_mm * 1e3
        assert found[1, 1] - found[0, 1] == pytest.approx(expected, abs=1e-6)


@given(chains)
def test_batch_is_loop(chain: Chain) -> None:
    q = positions(chain, 4)
    e = 1e-3 * RNG.normal(size=(4, len(chain.machine.terms)))
    together = chain.deviation(q, e)
    for i in range(4):
        alone = chain.deviation(q[i : i + 1], e[i : i + 1])
        np.testing.assert_allclose(together.position_mm[i], alone.position_mm[0], atol=1e-12)
        np.testing.assert_allclose(together.orientation_rad[i], alone.orientation_rad[0], atol=1e-15)
