"""What each error term means, and which matter most: the paper's principal and secondary terms.

Su, Li and Wang (2001, section 3) call a three-axis machine's 18 motion terms and 3 squareness errors its 21 principal
terms, and the other 15 location terms, two to three orders of magnitude smaller, secondary. Here the same is said of
any machine.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from model.machine import Machine
from model.terms import DIRECTIONS, Term
from model.transforms import Array

TermClass = Literal["principal", "secondary"]

PARALLEL = 0.1
"""Sine of the angle below which two axes count as parallel: they are to be parallel, and not square."""


def squareness_terms(machine: Machine) -> dict[str, str]:
    """Return the squareness terms of linear axes, each in words: "squareness of Z to X".

    The axis next to the bed is the reference, and each further one is square to those before it, about the line
    perpendicular to both, or parallel, about both lines perpendicular to it. Outwards, because a location error also
    turns what the body carries: of two stacked axes only the outer one's can change the angle between them. For the
    seed's machine these are γ of X, α and β of Z, as in its section 3.
    """
    found: dict[str, str] = {}
    before: list[tuple[str, Array]] = []
    for body in machine.bodies:
        if body.axis is None or machine.axes[body.axis].rotary:
            continue
        along = np.asarray(machine.axes[body.axis].direction)
        for other, other_along in before:
            about = np.cross(other_along, along)
            parallel = np.linalg.norm(about) < PARALLEL
            words = f"{'parallelism' if parallel else 'squareness'} of {body.axis} to {other}"
            for line in range(3) if parallel else [int(np.argmax(np.abs(about)))]:
                if line != _line(machine, body.axis):
                    found.setdefault(f"E{DIRECTIONS[3 + line]}0{body.axis}", words)
        before.append((body.axis, along))
    return found


def principal_terms(machine: Machine) -> frozenset[str]:
    """Return the names of the principal terms.

    Motion terms; squareness terms; of a rotary axis' location terms five, all but the shift along its own line, as
    controllers count them (with those a five-axis machine has 30 + 3 + 10 = 43); and those of a fixed body, which
    a machine has only where its description asks for spindle growth or fixture drift.
    """
    square = squareness_terms(machine)
    return frozenset(t.name for t in machine.terms if t.name in square or _always_principal(machine, t))


def term_class(machine: Machine) -> dict[str, TermClass]:
    """Return the class of each term."""
    principal = principal_terms(machine)
    return {t.name: "principal" if t.name in principal else "secondary" for t in machine.terms}


def meaning(machine: Machine, term: Term) -> str:
    """Return what a term is, in the words of ISO 230-1."""
    index = DIRECTIONS.index(term.direction)
    kind = "rotation about" if term.angular else "shift in"
    if term.axis not in machine.axes:
        return f"{kind} {'XYZ'[index % 3]} of '{machine.bodies[term.body].name}'"
    own = index % 3 == _line(machine, term.axis)
    if term.kind == "motion":
        return _motion_meaning(term, machine.axes[term.axis].rotary, own, "XYZ"[index % 3])
    square = squareness_terms(machine)
    if term.name in square:
        return square[term.name]
    if own and term.angular == machine.axes[term.axis].rotary:
        return f"zero position of {term.axis}"
    return f"{kind} {'XYZ'[index % 3]} of axis {term.axis}"


def _motion_meaning(term: Term, rotary: bool, own: bool, line: str) -> str:
    if own and term.angular == rotary:
        return f"positioning of {term.axis}"
    if term.angular:
        return f"roll of {term.axis}" if own else f"tilt of {term.axis} about {line}"
    if rotary:
        return f"axial motion of {term.axis}" if own else f"radial motion of {term.axis} in {line}"
    return f"straightness of {term.axis} in {line}"


def _always_principal(machine: Machine, term: Term) -> bool:
    if term.kind == "motion" or term.axis not in machine.axes:
        return True
    along_itself = DIRECTIONS.index(term.direction) == _line(machine, term.axis)
    return machine.axes[term.axis].rotary and not along_itself


def _line(machine: Machine, axis: str) -> int:
    """Return which of x, y, z an axis moves along or turns about, mostly."""
    return int(np.argmax(np.abs(machine.axes[axis].direction)))
