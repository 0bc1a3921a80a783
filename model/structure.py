"""Read a structure string such as "w Y X b Z t" into bodies and the lower-body array.

The string lists the chain from workpiece `w` over the bed `b` to the tool `t`, in the spirit of the ISO 10791
structural codes. Each axis letter is the body that the axis moves.
"""

from __future__ import annotations

from dataclasses import dataclass

from model.exceptions import MachineError

LINEAR_AXES = ("X", "Y", "Z", "U", "V", "W")
ROTARY_AXES = ("A", "B", "C")


@dataclass(frozen=True)
class Body:
    """One body of the machine.

    Attributes
    ----------
    name : "bed", an axis letter, "tool" or "workpiece"
    lower : index of its lower body, -1 for the bed
    axis : the axis that moves it, or None
    side : -1 between workpiece and bed, +1 between bed and tool, 0 for the bed
    """

    name: str
    lower: int
    axis: str | None
    side: int


def parse_structure(text: str, *, tool_body: bool, workpiece_body: bool) -> tuple[Body, ...]:
    """Return the bodies in the seed's order: bed, workpiece side outwards, tool side outwards.

    Parameters
    ----------
    text : the structure string, axis letters with or without spaces between them
    tool_body, workpiece_body : whether the fixed leaves carry location errors and so are bodies of their own

    Raises
    ------
    MachineError
        where the string is not `w ... b ... t` with each linear axis X, Y, Z once.
    """
    letters = text.replace(" ", "").replace("'", "").replace("′", "")
    for letter in letters:
        if letter not in (*LINEAR_AXES, *ROTARY_AXES, "w", "b", "t"):
            raise MachineError(
                f"structure {text!r} has {letter!r}; write axis letters between w, b and t, such as 'w Y X b Z t'"
            )
    for mark, what in (("w", "workpiece"), ("b", "bed"), ("t", "tool")):
        if letters.count(mark) != 1:
            raise MachineError(
                f"structure {text!r} must have one {mark} ({what}), got {letters.count(mark)}; "
                "write it as 'w Y X b Z t'"
            )
    if not (letters.startswith("w") and letters.endswith("t")):
        raise MachineError(f"structure {text!r} must run from w to t; write it as 'w Y X b Z t'")
    axes = [letter for letter in letters if letter.isupper()]
    for axis in axes:
        if axes.count(axis) > 1:
            raise MachineError(f"structure {text!r} has axis '{axis}' twice; each axis moves one body")
    if sorted(axes) != ["X", "Y", "Z"]:
        raise MachineError(
            f"structure {text!r} must have the three linear axes X, Y and Z, got {' '.join(axes) or 'none'}; "
            "other machines are not supported yet"
        )
    work_side, tool_side = letters[1:-1].split("b")
    bodies = [Body("bed", -1, None, 0)]
    for names, side, leaf, wanted in (
        (reversed(work_side), -1, "workpiece", workpiece_body),
        (iter(tool_side), +1, "tool", tool_body),
    ):
        lower = 0
        for name in names:
            bodies.append(Body(name, lower, name, side))
            lower = len(bodies) - 1
        if wanted:
            bodies.append(Body(leaf, lower, None, side))
    return tuple(bodies)


def lower_body_array(bodies: tuple[Body, ...]) -> list[int]:
    """Return the seed's array L: each body's lower body, numbered from 1, the bed's being 0."""
    return [body.lower + 1 for body in bodies]
