import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from machines import ARRANGEMENTS, machine_text

from model.chain import Chain
from model.compensation import SHARE, compensate
from model.error_map import ErrorMap
from model.exceptions import ComputeError
from model.machine import Machine, parse_machine

CHAINS = [Chain(parse_machine(machine_text(s, c))) for s in ARRANGEMENTS for c in ("motion-last", "seed")]


def random_errors(machine: Machine, rng: np.random.Generator, size: float = 1.0) -> ErrorMap:
    """Return terms of up to 1 mm and 1 mrad, five knots an axis."""
    rows: list[tuple[str, float | None, float]] = []
    for term in machine.terms:
        if term.kind == "location":
            rows.append((term.name, None, size * rng.uniform(-1000, 1000)))
        else:
            axis = machine.axes[term.axis]
            rows += [
                (term.name, float(p), size * rng.uniform(-1000, 1000)) for p in np.linspace(axis.low, axis.high, 5)
            ]
    return ErrorMap.from_rows(machine, rows)


@given(st.sampled_from(CHAINS), st.integers(0, 2**32 - 1), st.floats(0, 300))
@settings(deadline=None)
def test_corrected_coordinates_put_the_exact_tip_where_the_ideal_chain_has_it(
    chain: Chain, seed: int, length: float
) -> None:
    rng = np.random.default_rng(seed)
    machine = chain.machine
    errors = random_errors(machine, rng)
    low, high = zip(*((machine.axes[a].low, machine.axes[a].high) for a in machine.axis_names), strict=True)
    q = np.concatenate([rng.uniform(low, high, (20, 3)), [low, high]])
    tool = np.array([0.0, 0.0, -length])
    found = compensate(chain, q, errors, tool)
    tip = chain.tip(found.corrected, errors.evaluate(found.corrected), tool)
    np.testing.assert_allclose(tip, chain.tip(q, None, tool), atol=1e-6)  # 1 nm


def test_no_errors_no_correction() -> None:
    chain = CHAINS[0]
    q = np.array([[1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(compensate(chain, q, ErrorMap.zero(chain.machine)).corrected, q)


def test_positioning_error_is_undone_where_it_applies() -> None:
    """EXX = 10 µm everywhere on a tool-side X: command 10 µm less."""
    chain = Chain(parse_machine(machine_text("w Y b X Z t")))
    errors = ErrorMap.from_rows(chain.machine, [("EXX", 0.0, 10.0)])
    found = compensate(chain, np.array([[100.0, 0.0, 0.0]]), errors)
    np.testing.assert_allclose(found.corrected, [[99.99, 0.0, 0.0]], atol=1e-9)


def test_coordinates_beyond_the_range_are_reported_and_not_clipped() -> None:
    chain = Chain(parse_machine(machine_text("w Y b X Z t")))
    errors = ErrorMap.from_rows(chain.machine, [("EXX", 0.0, 10.0)])
    found = compensate(chain, np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]]), errors)
    assert found.outside.tolist() == [True, False]
    assert found.corrected[0, 0] == pytest.approx(-0.01)


def test_chunks_do_not_show() -> None:
    chain = CHAINS[0]
    rng = np.random.default_rng(5)
    errors = random_errors(chain.machine, rng, 0.01)
    q = rng.uniform([0, -250, 0], [800, 250, 500], (SHARE + 3, 3))
    whole = compensate(chain, q, errors)
    tail = compensate(chain, q[-5:], errors)
    np.testing.assert_allclose(whole.corrected[-5:], tail.corrected, atol=1e-9)
    assert compensate(chain, q[:0], errors).corrected.shape == (0, 3)


def test_errors_that_undo_the_motion_are_refused() -> None:
    """EXX falling by 2 mm per mm of X: no coordinate reaches the position for sure."""
    chain = Chain(parse_machine(machine_text("w Y b X Z t")))
    zigzag = [("EXX", float(p), 0.0 if p % 2 else 2000.0) for p in range(400)]
    with pytest.raises(ComputeError, match=r"compensation at X .* must reach 1 nm"):
        compensate(chain, np.array([[200.3, 0.0, 0.0]]), ErrorMap.from_rows(chain.machine, zigzag))
