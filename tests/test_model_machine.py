import pytest
from machines import machine_text

from model.exceptions import MachineError
from model.machine import load_machine, parse_machine, preset
from model.terms import canonical_name


def test_reads_what_is_written() -> None:
    machine = parse_machine(machine_text())
    assert machine.axis_names == ("X", "Y", "Z")
    assert (machine.axes["Y"].low, machine.axes["Y"].high) == (-250.0, 250.0)
    assert machine.axes["X"].direction == (-1.0, 0.0, 0.0)
    assert machine.axes["Z"].direction == (0.0, 0.0, 1.0)
    assert machine.sensors["spindle"].range_degC == (0.0, 80.0)
    assert machine.tool.offset_mm == (1.0, 2.0, -150.0)


def test_limits_are_on_without_being_asked_for() -> None:
    limits = parse_machine(machine_text()).limits
    assert (limits.max_correction_um, limits.max_rate_um_per_min) == (300.0, 60.0)


@pytest.mark.parametrize("structure", ["wXYbZt", "w X' Y' b Z t", " w X Y b Z t "])
def test_structure_with_primes_and_with_or_without_spaces(structure: str) -> None:
    bodies = [b.name for b in parse_machine(machine_text(structure)).bodies]
    assert bodies == ["bed", "Y", "X", "workpiece", "Z", "tool"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("composition =", "compositon =", "unknown key 'compositon' in .*; did you mean 'composition'\\?"),
        (
            "range_degC",
            "range_degF",
            r"unknown key 'sensors.spindle.range_degF' in .*; did you mean 'range_degC'\?",
        ),
        ('name = "test"', "", "key 'name' is missing in"),
        (
            '"motion-last"',
            '"motion-first"',
            "key 'composition' in .*: input should be 'motion-last' or 'seed', got",
        ),
        (
            "[0.0, 800.0]",
            "[800.0, 0.0]",
            r"key 'axes.X.range' in .* must rise, got \[800, 0\]; write \[lower, upper\]",
        ),
        ("[0.0, 800.0]", "[0.0, inf]", "key 'axes.X.range.1' in .*: input should be a finite number, got inf"),
        ("[0.0, 800.0]", '[0.0, "far"]', "key 'axes.X.range.1' in .*: input should be a valid number"),
        ("[axes.Z]", "[axes.Q]", "key 'axes.Q' in .*: the structure has no axis 'Q'; known are X, Y, Z"),
        ("w X Y b Z t", "w X Y Z t", "key 'structure' in .* must have one b \\(bed\\), got 0"),
        ("w X Y b Z t", "w X X b Z t", "key 'structure' in .* has axis 'X' twice"),
        ("w X Y b Z t", "X Y b Z w t", "key 'structure' in .* must run from w to t"),
        ("w X Y b Z t", "w X Y b Z q t", "key 'structure' in .* has 'q'; write axis letters"),
        ("w X Y b Z t", "w X Y b t", "key 'axes.Z' in .*: the structure has no axis 'Z'; known are X, Y"),
        (
            "w X Y b Z t",
            "w X Y b Z B t",
            "key 'axes.B' is missing in .*: give its range, such as",
        ),
        (
            "range_degC = [0.0, 80.0]",
            "range_degC = [80.0, 0.0]",
            "key 'sensors.spindle.range_degC' in .* must rise",
        ),
        (
            "range = [0.0, 800.0]",
            "range = [0.0, 800.0]\ndirection = [1.0, 1.0, 0.0]",
            "key 'axes.X.direction' in .* must be a unit vector, got length 1.41421; divide it by its length",
        ),
        (
            "range = [0.0, 800.0]",
            "range = [0.0, 800.0]\ndirection = [0.0, 0.0, 0.0]",
            "key 'axes.X.direction' in .* must be a unit vector, got length 0; give it a direction",
        ),
        ("[axes.X]", "[axes.X", "machine description is not TOML"),
    ],
)
def test_a_wrong_description_gets_one_sentence(old: str, new: str, message: str) -> None:
    text = machine_text()
    assert old in text
    with pytest.raises(MachineError, match=message) as caught:
        parse_machine(text.replace(old, new, 1))
    assert "\n" not in str(caught.value)
    assert str(caught.value)[0].islower()


def test_limits_must_be_positive() -> None:
    with pytest.raises(MachineError, match="key 'limits.max_correction_um' in .*: input should be greater than 0"):
        parse_machine(machine_text(extra="[limits]\nmax_correction_um = 0.0"))


def test_a_missing_file_is_named() -> None:
    with pytest.raises(MachineError, match="machine description 'no/such.toml' cannot be read: No such file"):
        load_machine("no/such.toml")


def test_an_unknown_preset_is_answered_with_the_known_ones() -> None:
    with pytest.raises(MachineError, match="unknown machine 'vmc33'; did you mean 'vmc3'?"):
        preset("vmc33")


@pytest.mark.parametrize(
    ("written", "stored"),
    [("X0C", "EX0C"), ("XOC", "EX0C"), ("EX0C", "EX0C"), ("EXOC", "EX0C"), ("exx", "EXX"), ("AZ", "EAZ")],
)
def test_spellings_of_terms(written: str, stored: str) -> None:
    assert canonical_name(written) == stored


def test_an_unknown_term_is_answered_with_a_near_one() -> None:
    machine = parse_machine(machine_text())
    assert machine.term("c0y").name == "EC0Y"
    with pytest.raises(MachineError, match="unknown error term 'EXQ' for machine 'test'; did you mean 'E"):
        machine.term("EXQ")


def test_units_of_terms() -> None:
    machine = parse_machine(machine_text())
    assert (machine.term("EXX").unit, machine.term("EXX").to_internal) == ("um", 1e-3)
    assert (machine.term("EC0Y").unit, machine.term("EC0Y").to_internal) == ("urad", 1e-6)
