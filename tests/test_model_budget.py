import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from machines import FIVE_AXIS, five_axis_text, machine_text

from model.budget import CHUNK, LOCATION_SHARE, Budget, budget, spread, unit_errors
from model.chain import Chain
from model.cli_budget import budget as command
from model.error_map import ErrorMap
from model.exceptions import DataError, MachineError
from model.machine import Machine, load_machine, parse_machine, preset

SEED = load_machine(preset("seed3"))
PLAIN = parse_machine(machine_text("w X Y b Z t", errors=False))


def shown(*args: object) -> str:
    done = CliRunner().invoke(command, [*map(str, args)], catch_exceptions=False)
    assert done.exit_code == 0
    return done.stdout


def by_name(found: Budget) -> dict[str, tuple[float, float]]:
    return {c.term.name: (c.tip_um, c.share) for c in found.contributions}


def random_map(machine: Machine, seed: int) -> ErrorMap:
    rng = np.random.default_rng(seed)
    rows = [
        (t.name, p, float(rng.normal(0.0, 10.0)))
        for t in machine.terms
        for p in (
            [None] if t.kind == "location" else np.linspace(machine.axes[t.axis].low, machine.axes[t.axis].high, 4)
        )
    ]
    return ErrorMap.from_rows(machine, rows)


def test_the_seed_machine_has_21_principal_and_15_secondary_terms_that_hardly_count() -> None:
    found = json.loads(shown("seed3", "--tool-length", 150, "--json"))
    assert {name: c["count"] for name, c in found["classes"].items()} == {"principal": 21, "secondary": 15}
    assert found["classes"]["principal"]["share"] > 0.999
    felt = [t for t in found["terms"] if t["tip_um"] > 1e-9]
    assert [t["class"] for t in felt] == sorted(t["class"] for t in felt)  # each principal one before each secondary
    assert {t["term"] for t in found["terms"] if t["tip_um"] <= 1e-9} == {"ECZ", "EC0Z"}  # the tool turns about itself


def test_unit_uncertainties_are_10_um_and_10_urad_and_a_share_of_them() -> None:
    e = unit_errors(SEED)
    assert e[SEED.term_index["EXX"]] == pytest.approx(10e-3)
    assert e[SEED.term_index["EC0X"]] == pytest.approx(10e-6)
    assert e[SEED.term_index["EX0Z"]] == pytest.approx(10e-3 * LOCATION_SHARE)


def test_shares_of_independent_terms_are_positive_and_their_squares_add_up() -> None:
    found = budget(Chain(SEED), points=100)
    assert sum(c.share for c in found.contributions) == pytest.approx(1.0)
    assert all(c.share >= 0 for c in found.contributions)
    assert found.tip_um == pytest.approx(np.sqrt(sum(c.tip_um**2 for c in found.contributions)))
    assert found.tilt_urad == pytest.approx(np.sqrt(sum(c.tilt_urad**2 for c in found.contributions)))
    assert budget(Chain(SEED), points=100, location_share=0.0).share("secondary") == 0.0


def test_a_single_shift_is_felt_as_it_is() -> None:
    found = budget(Chain(PLAIN), ErrorMap.from_rows(PLAIN, [("EXX", 0.0, -7.0)]), points=50)
    first = found.contributions[0]
    assert (first.term.name, found.tip_um, first.tip_um) == ("EXX", pytest.approx(7.0), pytest.approx(7.0))
    assert (first.size, first.share, first.tilt_urad) == (pytest.approx(7.0), pytest.approx(1.0), 0.0)


def test_a_term_that_makes_up_for_another_has_a_negative_share() -> None:
    """10 µm and -4 µm in one direction: of 6² µm² the first brings 10 * 6, the second -4 * 6."""
    found = budget(Chain(PLAIN), ErrorMap.from_rows(PLAIN, [("EXX", 0.0, 10.0), ("EX0X", None, -4.0)]), points=50)
    assert found.tip_um == pytest.approx(6.0)
    assert by_name(found)["EXX"] == pytest.approx((10.0, 10 / 6))
    assert by_name(found)["EX0X"] == pytest.approx((4.0, -4 / 6))


def test_without_errors_nothing_has_a_share() -> None:
    found = budget(Chain(PLAIN), ErrorMap.zero(PLAIN), points=20)
    assert found.tip_um == 0.0
    assert all(c.share == 0.0 for c in found.contributions)


@pytest.mark.parametrize("structure", FIVE_AXIS)
def test_the_whole_is_the_exact_chains_deviation(structure: str) -> None:
    machine = parse_machine(five_axis_text(structure))
    chain, errors, points = Chain(machine), random_map(machine, 3), CHUNK + 100
    tool = np.array([3.0, -2.0, -80.0])
    found = budget(chain, errors, tool_mm=tool, points=points)
    q = spread(machine, points)
    exact = chain.deviation(q, errors.evaluate(q), tool)
    rms_um = np.sqrt(np.square(exact.position_mm).sum(axis=1).mean()) * 1e3
    rms_urad = np.sqrt(np.square(exact.orientation_rad).sum(axis=1).mean()) * 1e6
    assert found.tip_um == pytest.approx(rms_um, rel=1e-3)
    assert found.tilt_urad == pytest.approx(rms_urad, rel=1e-3)
    assert sum(c.share for c in found.contributions) == pytest.approx(1.0)


@pytest.mark.parametrize("machine", [SEED, parse_machine(five_axis_text(FIVE_AXIS[0]))])
def test_positions_fill_the_volume_evenly(machine: Machine) -> None:
    """The mean of evenly spread points is nearer to the middle than that of random ones, by orders."""
    q = spread(machine, 2000)
    low = np.array([machine.axes[a].low for a in machine.axis_names])
    high = np.array([machine.axes[a].high for a in machine.axis_names])
    assert (q >= low).all()
    assert (q <= high).all()
    unit = (q - low) / (high - low)
    np.testing.assert_allclose(unit.mean(axis=0), 0.5, atol=3e-3)
    np.testing.assert_allclose(np.cov(unit.T), np.eye(len(low)) / 12, atol=6e-3)


def test_the_command_prints_a_ranking_and_draws_it(tmp_path: Path) -> None:
    (tmp_path / "errors.csv").write_text("term,position,value\nEXX,0,5\nEC0X,,-20\n")
    text = shown("seed3", "--errors", tmp_path / "errors.csv", "--picture", tmp_path / "budget.png", "--points", 64)
    assert text.index("EC0X") < text.index("EXX")
    assert "21 principal terms make 100.000 % of the mean square" in text
    assert (tmp_path / "budget.png").read_bytes().startswith(b"\x89PNG")


def test_a_budget_of_nothing_and_one_of_many_terms_are_drawn(tmp_path: Path) -> None:
    (tmp_path / "none.csv").write_text("term,position,value\n")
    shown("vmc3", "--errors", tmp_path / "none.csv", "--picture", tmp_path / "none.png", "--points", 4)
    (tmp_path / "machine.toml").write_text(five_axis_text(FIVE_AXIS[0]))
    shown(tmp_path, "--picture", tmp_path / "many.png", "--points", 4)
    assert (tmp_path / "none.png").exists()
    assert (tmp_path / "many.png").exists()


TWINS = """
name = "twins"
bodies = [
    { name = "bed" },
    { name = "table", lower = "bed", axis = "X" },
    { name = "workpiece", lower = "table" },
    { name = "left", lower = "bed", axis = "Z" },
    { name = "right", lower = "bed", axis = "W" },
    { name = "tool1", lower = "left" },
    { name = "tool2", lower = "right" },
]
axes.X.range = [0, 500]
axes.Z.range = [0, 300]
axes.W.range = [0, 300]
"""


def test_of_several_tools_one_is_named_and_only_its_own_terms_count(tmp_path: Path) -> None:
    (tmp_path / "machine.toml").write_text(TWINS)
    found = json.loads(shown(tmp_path, "--tool", "tool2", "--json", "--points", 8))
    felt = {t["term"][-1] for t in found["terms"] if t["tip_um"] > 0}
    assert felt == {"X", "W"}
    with pytest.raises(MachineError, match="^machine 'twins' has the tools tool1, tool2; name one"):
        shown(tmp_path)


def test_a_tool_length_that_is_no_number_gets_one_sentence() -> None:
    with pytest.raises(DataError, match="^--tool-length must be a finite number of mm, got nan"):
        shown("seed3", "--tool-length", "nan")
