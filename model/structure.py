"""Read how a machine is built, into bodies and the lower-body array.

One chain is written as a string that lists it from workpiece `w` over the bed `b` to the tool `t`, in the spirit of
the ISO 10791 structural codes: "w C' A' Y' X' b Z (C) t". Anything else is a table of bodies, each with its lower
body: a tree.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from model.exceptions import MachineError
from model.validation import did_you_mean

LINEAR_AXES = ("X", "Y", "Z", "U", "V", "W")
ROTARY_AXES = ("A", "B", "C")
AXES = (*LINEAR_AXES, *ROTARY_AXES)
EXAMPLE = "write it as 'w Y X b Z t'"


@dataclass(frozen=True)
class Body:
    """One body of the machine.

    Attributes
    ----------
    name : "bed", an axis letter, "tool", "workpiece", or whatever the table of bodies calls it
    lower : index of its lower body, -1 for the bed
    axis : the axis that moves it, or None
    side : -1 between workpiece and bed, +1 elsewhere, 0 for the bed and for what carries both workpiece and tool
    suffix : ending of its location terms' names: the axis, "T" (tool holder), "W" (fixture); None without such terms
    """

    name: str
    lower: int
    axis: str | None
    side: int = 0
    suffix: str | None = None


@dataclass(frozen=True)
class Layout:
    """A machine's bodies and what they carry.

    Attributes
    ----------
    bodies : bed first, each behind its lower body
    workpiece : index of the body that carries the workpiece
    tools : by name, index of the body that carries the tool
    """

    bodies: tuple[Body, ...]
    workpiece: int
    tools: dict[str, int]


@dataclass(frozen=True)
class BodyEntry:
    """A row of the table of bodies, as it is written."""

    name: str
    lower: str | None
    axis: str | None


def parse_structure(
    text: str, *, tool_errors: bool, workpiece_errors: bool, workpiece_axes: int | None = None
) -> Layout:
    """Return the layout of one chain, in the seed's order: bed, workpiece side outwards, tool side outwards.

    Parameters
    ----------
    text : axis letters between w, b and t, with or without spaces, primes and an ISO 10791 frame "V [...]"; a spindle
        that is not positioned stands in parentheses and is left out. Also Renishaw's spelling, in which F is the
        bed ("YFXZ"), and that of ISG and Beckhoff ("CBYXZ"), with `workpiece_axes` axes on the workpiece side
    tool_errors, workpiece_errors : whether the leaves have location errors, and so are bodies of their own

    Raises
    ------
    MachineError
        where the string is not a chain from w over b to t, or names an axis twice.
    """
    letters = _letters(text, workpiece_axes)
    for letter in letters:
        if letter not in (*AXES, "w", "b", "t"):
            raise MachineError(
                f"structure {text!r} has {letter!r}; write axis letters between w, b and t, such as 'w Y X b Z t'"
            )
    for mark, what in (("w", "workpiece"), ("b", "bed"), ("t", "tool")):
        if letters.count(mark) != 1:
            raise MachineError(
                f"structure {text!r} must have one {mark} ({what}), got {letters.count(mark)}; {EXAMPLE}"
            )
    if not (letters.startswith("w") and letters.endswith("t")):
        raise MachineError(f"structure {text!r} must run from w to t; {EXAMPLE}")
    for axis in letters[1:-1].replace("b", ""):
        if letters.count(axis) > 1:
            raise MachineError(f"structure {text!r} has axis '{axis}' twice; each axis moves one body")
    work_side, tool_side = letters[1:-1].split("b")
    entries = [BodyEntry("bed", None, None)]
    for names, leaf in ((work_side[::-1], "workpiece"), (tool_side, "tool")):
        lower = "bed"
        for name in names:
            entries.append(BodyEntry(name, lower, name))
            lower = name
        entries.append(BodyEntry(leaf, lower, None))
    return lay_out(entries, tool_errors=tool_errors, workpiece_errors=workpiece_errors)


def lay_out(entries: Sequence[BodyEntry], *, tool_errors: bool, workpiece_errors: bool) -> Layout:
    """Return the layout of a tree of bodies; leaves without location errors are no bodies of their own.

    The bed is the one body without a lower body, the workpiece the one called "workpiece", tools are those without
    axis whose name begins with "tool".

    Raises
    ------
    MachineError
        for two beds or none, a name twice, an unknown lower body or axis, an axis twice, a cycle, no workpiece or
        no tool.
    """
    _check_entries(entries)
    rows = _in_order(entries)
    kept: list[Body] = []
    index: dict[str, int] = {}
    leaves: dict[str, int] = {}
    for row in rows:
        lower = -1 if row.lower is None else index[row.lower]
        suffix = row.axis
        if _is_leaf(row):
            suffix = "W" if row.name == "workpiece" else "T" + row.name.removeprefix("tool").upper().lstrip("_-")
            if not (workpiece_errors if row.name == "workpiece" else tool_errors):
                leaves[row.name] = index[row.name] = lower
                continue
        index[row.name] = len(kept)
        kept.append(Body(row.name, lower, row.axis, suffix=suffix))
        if _is_leaf(row):
            leaves[row.name] = index[row.name]
    _check_suffixes(kept)
    tools = {name: at for name, at in leaves.items() if name != "workpiece"}
    work_path = set(path_to(kept, leaves["workpiece"]))
    tool_paths = set().union(*(path_to(kept, at) for at in tools.values()))
    bodies = tuple(
        replace(body, side=0 if i == 0 or (i in work_path and i in tool_paths) else -1 if i in work_path else 1)
        for i, body in enumerate(kept)
    )
    return Layout(bodies, leaves["workpiece"], tools)


def path_to(bodies: Sequence[Body], index: int) -> list[int]:
    """Return the bodies from the bed to the one at `index`, both included."""
    path: list[int] = []
    while index >= 0:
        path.append(index)
        index = bodies[index].lower
    return path[::-1]


def lower_body_array(bodies: Sequence[Body]) -> list[int]:
    """Return the seed's array L: each body's lower body, numbered from 1, the bed's being 0."""
    return [body.lower + 1 for body in bodies]


def _letters(text: str, workpiece_axes: int | None) -> str:
    bare = re.sub(r"^\s*[A-Za-z]?\s*\[(.*)\]\s*$", r"\1", text)
    bare = re.sub(r"\([^)]*\)", "", bare)
    letters = re.sub(r"[\s'′0-9]", "", bare)
    if workpiece_axes is not None:
        if not 0 <= workpiece_axes <= len(letters) or not letters.isupper():
            raise MachineError(
                f"workpiece_axes must be a part of the {len(letters)} axes of structure {text!r}, got {workpiece_axes}"
            )
        return f"w{letters[:workpiece_axes]}b{letters[workpiece_axes:]}t"
    if letters.isupper() and letters.count("F") == 1:
        return f"w{letters.replace('F', 'b')}t"
    return letters


def _is_leaf(row: BodyEntry) -> bool:
    return row.axis is None and (row.name == "workpiece" or row.name.startswith("tool"))


def _check_entries(entries: Sequence[BodyEntry]) -> None:
    names = [e.name for e in entries]
    _once(names, "body '{}' stands twice in the table of bodies; give each its own name")
    _once([e.axis for e in entries if e.axis], "axis '{}' moves two bodies; each axis moves one body")
    beds = [e.name for e in entries if e.lower is None]
    if len(beds) != 1:
        raise MachineError(
            f"the table of bodies must have one bed, a body without 'lower', got {', '.join(beds) or 'none'}"
        )
    for entry in entries:
        if entry.axis is not None and entry.axis not in AXES:
            raise MachineError(
                f"body '{entry.name}' has the unknown axis '{entry.axis}'" + did_you_mean(entry.axis, [*AXES])
            )
        if entry.lower is not None and entry.lower not in names:
            raise MachineError(
                f"body '{entry.name}' has the unknown lower body '{entry.lower}'" + did_you_mean(entry.lower, names)
            )
        if entry.lower is None and entry.axis is not None:
            raise MachineError(
                f"body '{entry.name}' is the bed and cannot be moved by axis '{entry.axis}'; give it a lower body"
            )
        if any(e.lower == entry.name for e in entries) and _is_leaf(entry):
            raise MachineError(f"body '{entry.name}' must be a leaf, but carries another body; call it otherwise")
    if not any(e.name == "workpiece" for e in entries):
        raise MachineError("the table of bodies must have a leaf called 'workpiece', got none")
    if not any(_is_leaf(e) and e.name != "workpiece" for e in entries):
        raise MachineError("the table of bodies must have a leaf whose name begins with 'tool', got none")


def _check_suffixes(bodies: Sequence[Body]) -> None:
    """Refuse two bodies whose location terms would have the same names: an axis W and a fixture, two like tools."""
    seen: dict[str, str] = {}
    for body in bodies:
        if body.suffix is None:
            continue
        if body.suffix in seen:
            raise MachineError(
                f"bodies '{seen[body.suffix]}' and '{body.name}' would both have the location terms "
                f"EX0{body.suffix} ... EC0{body.suffix}; name one of them otherwise, or leave out its errors"
            )
        seen[body.suffix] = body.name


def _once(values: Iterable[str], sentence: str) -> None:
    seen: set[str] = set()
    for value in values:
        if value in seen:
            raise MachineError(sentence.format(value))
        seen.add(value)


def _in_order(entries: Sequence[BodyEntry]) -> list[BodyEntry]:
    """Return the entries with each behind its lower body, otherwise as they are written."""
    done: list[BodyEntry] = []
    waiting = list(entries)
    while waiting:
        placed = {e.name for e in done}
        ready = next((e for e in waiting if e.lower is None or e.lower in placed), None)
        if ready is None:
            names = ", ".join(e.name for e in waiting)
            raise MachineError(f"the lower bodies of {names} run in a circle; each must lead to the bed")
        done.append(ready)
        waiting.remove(ready)
    return done
