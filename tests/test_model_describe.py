import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from machines import ARRANGEMENTS, FIVE_AXIS, five_axis_text, machine_text

from model.chain import Chain
from model.cli_describe import describe
from model.describe import describe_machine, direction_text, lower_body_powers
from model.exceptions import DataError, MachineError
from model.machine import load_machine, parse_machine, preset
from model.machine_source import machine_at
from model.pictures import draw_chain
from model.structure import lower_body_array
from model.term_classes import meaning, principal_terms, squareness_terms

SEED = load_machine(preset("seed3"))


def shown(*args: object) -> str:
    done = CliRunner().invoke(describe, [*map(str, args)], catch_exceptions=False)
    assert done.exit_code == 0
    return done.stdout


def test_the_seed_machines_powers_are_the_papers_table_1() -> None:
    assert lower_body_powers(lower_body_array(SEED.bodies)) == [[1, 2, 3, 4], [0, 1, 2, 1], [0, 0, 1, 0], [0, 0, 0, 0]]


@pytest.mark.parametrize("structure", FIVE_AXIS)
def test_each_power_is_the_array_of_the_one_before_and_the_last_is_zero(structure: str) -> None:
    array = lower_body_array(parse_machine(five_axis_text(structure)).bodies)
    rows = lower_body_powers(array)
    assert rows[0] == list(range(1, len(array) + 1))
    for row, following in pairwise(rows):
        assert following == [array[j - 1] if j else 0 for j in row]
        assert any(row)
    assert not any(rows[-1])


def test_the_seed_machine_has_the_papers_21_principal_terms() -> None:
    motion = {t.name for t in SEED.terms if t.kind == "motion"}
    assert set(squareness_terms(SEED)) == {"EC0X", "EA0Z", "EB0Z"}  # the paper's γ23, α14 and β14
    assert principal_terms(SEED) == motion | {"EC0X", "EA0Z", "EB0Z"}
    assert len(principal_terms(SEED)) == 21


@pytest.mark.parametrize("structure", ARRANGEMENTS)
def test_squareness_terms_shear_the_working_volume_in_all_the_ways_that_location_terms_can(structure: str) -> None:
    """What is left of a location term's displacement without squareness is that of a rigid body."""
    machine = parse_machine(machine_text(structure, errors=False))
    chain = Chain(machine)
    origin = chain.sensitivity(np.zeros((1, 3)))[0, :3]
    slopes = np.stack([chain.sensitivity(100.0 * np.eye(3)[[i]])[0, :3] - origin for i in range(3)]) / 100.0
    shear = slopes + np.swapaxes(slopes, 0, 1)  # (3, 3, K): the tip moves with +1 along each axis
    flat = shear.reshape(9, -1)
    squareness = [machine.term_index[t] for t in squareness_terms(machine)]
    assert len(squareness) == 3
    assert np.linalg.matrix_rank(flat[:, squareness], tol=1e-6) == 3
    assert np.linalg.matrix_rank(flat[:, machine.location_columns], tol=1e-6) == 3


@pytest.mark.parametrize("structure", FIVE_AXIS)
def test_a_five_axis_machine_has_43_principal_terms_beside_those_of_fixed_bodies(structure: str) -> None:
    machine = parse_machine(five_axis_text(structure))
    fixed = {t.name for t in machine.terms if t.axis in "TW"}
    assert len(fixed) == 12
    assert len(principal_terms(machine) - fixed) == 43


def test_an_axis_parallel_to_another_is_aligned_about_both_other_lines() -> None:
    machine = parse_machine(machine_text("w X Y b U Z t", extra="[axes.U]\nrange = [0.0, 100.0]"))
    assert squareness_terms(machine) == {
        "EC0X": "squareness of X to Y",
        "EC0U": "squareness of U to Y",
        "EB0U": "parallelism of U to X",
        "EA0Z": "squareness of Z to Y",
        "EB0Z": "squareness of Z to X",
    }


@pytest.mark.parametrize(
    ("term", "expected"),
    [
        ("EXX", "positioning of X"),
        ("EYX", "straightness of X in Y"),
        ("EAX", "roll of X"),
        ("EBX", "tilt of X about Y"),
        ("EZ0Z", "zero position of Z"),
        ("EX0Z", "shift in X of axis Z"),
        ("EC0Z", "rotation about Z of axis Z"),
        ("EC0X", "squareness of X to Y"),
        ("ECC", "positioning of C"),
        ("EZC", "axial motion of C"),
        ("EXC", "radial motion of C in X"),
        ("EAC", "tilt of C about X"),
        ("EC0C", "zero position of C"),
        ("EX0C", "shift in X of axis C"),
        ("EB0C", "rotation about Y of axis C"),
        ("EZ0T", "shift in Z of 'tool'"),
        ("EA0W", "rotation about X of 'workpiece'"),
    ],
)
def test_terms_are_called_what_iso_230_calls_them(term: str, expected: str) -> None:
    machine = parse_machine(five_axis_text("w C A X Y b Z t"))
    assert meaning(machine, machine.term(term)) == expected


def test_directions_are_written_as_letters_where_they_are_along_one() -> None:
    assert direction_text((0.0, -1.0, 0.0)) == "-Y"
    assert direction_text((0.6, 0.0, 0.8)) == "(0.6, 0, 0.8)"


def test_the_command_shows_tree_array_axes_and_terms() -> None:
    text = shown("seed3")
    for line in (
        "└── 3 X: moves along +X, carries workpiece",
        "└── 4 Z: moves along +Z, carries tool",
        "│ L^1(j) │     0 │   1 │   2 │   1 │",
        "0 ... 800 mm",
        "36 error terms: 21 principal, 15 secondary",
    ):
        assert line in text


def test_the_command_shows_fixed_bodies_and_rotary_axes(tmp_path: Path) -> None:
    (tmp_path / "machine.toml").write_text(five_axis_text("w C A Y X b Z t"))
    text = shown(tmp_path)
    assert ": turns about -Z" in text
    assert "8 tool: fixed\n" in text
    assert "-110 ... 110 degree" in text


def test_json_has_the_same_facts() -> None:
    facts = json.loads(shown("vmc3", "--json"))
    assert facts == describe_machine(load_machine(preset("vmc3")))
    assert facts["lower_body_array"] == [0, 1, 2, 1, 4]
    assert facts["workpiece_on"] == 3
    assert facts["tools_on"] == {"tool": 5}
    assert list(facts["axes"]) == ["X", "Y", "Z"]
    assert facts["axes"]["X"]["side"] == "workpiece"
    assert {"name": "EC0X", "class": "principal", "unit": "urad"}.items() <= facts["terms"][23].items()


TWO_HEADS = machine_text(errors=False).replace(
    'structure = "w X Y b Z t"',
    "bodies = [{name='bed'}, {name='Y', lower='bed', axis='Y'}, {name='table', lower='Y', axis='X'}, "
    "{name='workpiece', lower='table'}, {name='head', lower='bed', axis='Z'}, "
    "{name='tool1', lower='head'}, {name='tool2', lower='head'}]",
)


def test_a_body_that_carries_two_tools_says_so(tmp_path: Path) -> None:
    (tmp_path / "machine.toml").write_text(TWO_HEADS)
    assert "4 head: moves along +Z, carries tool1 and tool2" in shown(tmp_path)


@pytest.mark.parametrize("source", [TWO_HEADS, machine_text(errors=False), five_axis_text("w C A Y X b Z t")])
def test_the_chain_is_drawn(tmp_path: Path, source: str) -> None:
    (tmp_path / "machine.toml").write_text(source)
    shown(tmp_path, "--picture", tmp_path / "chain.png")
    assert (tmp_path / "chain.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("file", "reason"), [("chain.docx", "Format 'docx' is not supported"), ("none/chain.png", "No such file")]
)
def test_a_picture_that_cannot_be_written_gets_one_sentence(tmp_path: Path, file: str, reason: str) -> None:
    with pytest.raises(DataError, match=f"^picture '.*' cannot be written: {reason}"):
        draw_chain(tmp_path / file, SEED)


def test_a_machine_is_a_file_a_folder_or_a_preset(tmp_path: Path) -> None:
    file = tmp_path / "machine.toml"
    file.write_text(machine_text())
    for written in (file, tmp_path):
        assert machine_at(written).name == "test"
    assert machine_at("seed3") == SEED
    with pytest.raises(MachineError, match="^unknown machine 'sed3'; did you mean 'seed3'"):
        machine_at("sed3")
    with pytest.raises(MachineError, match=r"^machine description 'no/seed3.toml' cannot be read: No such file"):
        machine_at("no/seed3.toml")
