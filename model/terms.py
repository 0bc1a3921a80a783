"""Error terms, named after ISO 230-1.

`E` + direction + moving axis is a *motion* error (`EYX`: straightness of X in Y), a function of that axis'
position and of time. `E` + direction + `0` + axis is a *location* error (`EC0Y`: squareness of Y to X), a
function of time alone. A fixed body, the tool holder `T` or the fixture `W`, has location errors only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

DIRECTIONS = ("X", "Y", "Z", "A", "B", "C")
"""The six degrees of freedom of a body, in the order of a rigid body's small displacement (ISO 841)."""

UM = 1e-3
"""Millimetres in a micrometre."""
URAD = 1e-6
"""Radians in a microradian."""


@dataclass(frozen=True)
class Term:
    """One error term of one body.

    Attributes
    ----------
    name : "EXX", "EC0Y", "EX0T"
    kind : "motion" (a function of the axis' position) or "location"
    direction : "X" ... "C", what is displaced or turned
    axis : "X" ... "C" of the moving axis, or "T" / "W" for a fixed body
    body : index of the body in the machine's lower-body array, from 0 (the bed)
    """

    name: str
    kind: Literal["motion", "location"]
    direction: str
    axis: str
    body: int

    @property
    def angular(self) -> bool:
        """Whether the term is an angle [µrad] and not a length [µm]."""
        return self.direction in "ABC"

    @property
    def unit(self) -> Literal["um", "urad"]:
        """Unit suffix of the term wherever a number leaves the program."""
        return "urad" if self.angular else "um"

    @property
    def to_internal(self) -> float:
        """Factor from µm or µrad to mm or rad."""
        return URAD if self.angular else UM


def motion_terms(axis: str, body: int) -> list[Term]:
    """Return the six motion terms of a moving body, `EX?` to `EC?`."""
    return [Term(f"E{d}{axis}", "motion", d, axis, body) for d in DIRECTIONS]


def location_terms(axis: str, body: int) -> list[Term]:
    """Return the six location terms of a body, `EX0?` to `EC0?`."""
    return [Term(f"E{d}0{axis}", "location", d, axis, body) for d in DIRECTIONS]


def canonical_name(written: str) -> str:
    """Return the one spelling stored of a term: `X0C`, `XOC` and `EX0C` are `EX0C`, `xx` is `EXX`.

    Standards and controllers write names with and without `E`, with a zero or the letter O. Whether the term
    exists is for the machine to say.
    """
    name = written.strip().upper()
    if len(name) == 2 or (len(name) == 3 and name[1] in "0O"):  # XX and X0C: without the E
        name = "E" + name
    if len(name) == 4 and name[2] == "O":
        name = f"{name[:2]}0{name[3]}"
    return name
