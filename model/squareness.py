"""Squareness of linear axes, in the signs that instruments write it, as location terms.

Squareness is an angle between two lines, so it has neither side nor reference body; a location term turns one body
against its lower body. Which body has to turn depends on the machine: turning one that carries the other axis turns
both lines and leaves the angle as it was.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import combinations
from typing import Literal

import numpy as np

from model.error_map import ErrorMap, Row
from model.exceptions import DataError
from model.machine import UNIT_VECTORS, Machine
from model.structure import LINEAR_AXES, ROTARY_AXES, path_to

SquarenessSign = Literal["RIGHT_HANDED", "LARGER_THAN_90"]
"""Renishaw CARTO's two keywords.

RIGHT_HANDED : the pair's second axis is turned against its first by the right-hand rule about the third direction.
    "XZ" = +10 µrad: Z leans towards +X, and the angle from +X to +Z is 90° - 10 µrad; for "XY" and "YZ" it is larger.
LARGER_THAN_90 : +10 µrad is an angle of 90° + 10 µrad between the two positive directions, whichever the pair.
"""


def squareness_rows(machine: Machine, angles_urad: Mapping[str, float], sign: SquarenessSign) -> list[Row]:
    """Return measured squareness as rows of an error table ("body" form, see `model.relative_to`).

    Parameters
    ----------
    angles_urad : by pair of axes, "XY" or as CARTO writes it "XWY" [µrad]

    Raises
    ------
    DataError
        for a pair that is not two linear axes at right angles, or a machine whose location terms do not turn lines.
    """
    if machine.composition == "seed":
        raise DataError(
            f"squareness of machine '{machine.name}' must go into its straightness terms: with composition 'seed' no "
            "location term turns an axis' own line; use composition 'motion-last'"
        )
    rows: list[Row] = []
    index = {body.axis: i for i, body in enumerate(machine.bodies)}
    for written, value in angles_urad.items():
        first, second = _pair(machine, written)
        turned = value * _to_right_handed(machine, first, second, sign)
        letter = ROTARY_AXES[_third(machine, first, second) or 0]
        if index[second] in path_to(machine.bodies, index[first]):  # the second carries the first
            rows.append((f"E{letter}0{first}", None, -turned))
        else:
            rows.append((f"E{letter}0{second}", None, turned))
    return rows


def squareness(machine: Machine, rows: Iterable[Row], sign: SquarenessSign) -> dict[str, float]:
    """Return the squareness that the location terms of an error table make, by pair of axes [µrad].

    The first-order angle, with rotary axes at 0, of composition "motion-last". Pairs of axes that are not at right
    angles are left out.
    """
    errors = ErrorMap.from_rows(machine, rows)
    location = dict(zip(machine.location_columns, errors.location, strict=True))
    turned = {}  # the line of each axis, by the angles of all bodies up to its own
    for i, body in enumerate(machine.bodies):
        if body.axis is not None:
            on_the_way = set(path_to(machine.bodies, i))
            turned[body.axis] = [
                sum(
                    float(location[k]) / term.to_internal
                    for k, term in enumerate(machine.terms)
                    if term.kind == "location" and term.body in on_the_way and term.direction == letter
                )
                for letter in ROTARY_AXES
            ]
    found = {}
    for first, second in combinations(_linear(machine), 2):
        third = _third(machine, first, second)
        if third is not None:
            value = turned[second][third] - turned[first][third]
            found[first + second] = value * _to_right_handed(machine, first, second, sign)
    return found


def _linear(machine: Machine) -> list[str]:
    return [a for a in machine.axis_names if a in LINEAR_AXES]


def _pair(machine: Machine, written: str) -> tuple[str, str]:
    """Return the two axes of a pair."""
    letters = written.strip().upper()
    if len(letters) == 3 and letters[1] == "W":  # XWY
        letters = letters[0] + letters[2]
    known = _linear(machine)
    if len(letters) != 2 or any(a not in known for a in letters) or _third(machine, *letters) is None:
        raise DataError(f"squareness '{written}' must name two of the axes {', '.join(known)} at right angles, as 'XY'")
    return letters[0], letters[1]


def _third(machine: Machine, first: str, second: str) -> int | None:
    """Return the direction, 0 to 2, about which two axes at right angles turn against each other, or None."""
    for name in (first, second):
        if abs(float(np.dot(UNIT_VECTORS[name], machine.axes[name].direction))) < 1.0 - 1e-9:
            return None
    directions = [LINEAR_AXES.index(name) % 3 for name in (first, second)]
    return None if directions[0] == directions[1] else 3 - sum(directions)


def _to_right_handed(machine: Machine, first: str, second: str, sign: SquarenessSign) -> float:
    """Return the factor, 1 or -1, from that sign to right-handed; it is its own inverse."""
    if sign == "RIGHT_HANDED":
        return 1.0
    third = _third(machine, first, second)
    assert third is not None
    sides = {body.axis: body.side or 1 for body in machine.bodies}
    along = {a: sides[a] * np.asarray(machine.axes[a].direction) for a in (first, second)}  # of tool against workpiece
    opened = -np.cross(np.eye(3)[third], along[second]) @ along[first]
    return float(np.sign(opened))
