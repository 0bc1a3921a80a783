"""What a machine description says, spelled out: bodies, lower-body array, axes, terms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from model.machine import Machine
from model.structure import lower_body_array
from model.term_classes import meaning, term_class

SIDES = {-1: "workpiece", 0: "both", 1: "tool"}


def lower_body_powers(array: list[int]) -> list[list[int]]:
    """Return the rows L^0, L^1, ... of the seed's Table 1, down to the first that is all zero.

    Parameters
    ----------
    array : L, the number of each body's lower body, counted from 1, the bed's being 0

    Returns
    -------
    rows of one length; row n holds L^n(j) of the bodies j = 1, 2, ..., with L^n(j) = L(L^(n-1)(j)) and L(0) = 0
    """
    rows = [list(range(1, len(array) + 1))]
    while any(rows[-1]):
        rows.append([array[j - 1] if j else 0 for j in rows[-1]])
    return rows


def direction_text(direction: Sequence[float]) -> str:
    """Return "+X" for a unit vector along x, its components for one that is along none."""
    for letter, value in zip("XYZ", direction, strict=True):
        if abs(value) == 1.0:
            return f"{'+' if value > 0 else '-'}{letter}"
    return f"({', '.join(f'{v:.4g}' for v in direction)})"


def describe_machine(machine: Machine) -> dict[str, Any]:
    """Return the description as plain values, ready for JSON."""
    classes = term_class(machine)
    array = lower_body_array(machine.bodies)
    sides = {body.axis: SIDES[body.side] for body in machine.bodies if body.axis is not None}
    return {
        "name": machine.name,
        "composition": machine.composition,
        "reference_temperature_degC": machine.reference_temperature_degC,
        "bodies": [
            {"number": j, "name": body.name, "lower": lower, "axis": body.axis}
            for j, (body, lower) in enumerate(zip(machine.bodies, array, strict=True), start=1)
        ],
        "workpiece_on": machine.layout.workpiece + 1,
        "tools_on": {name: at + 1 for name, at in machine.layout.tools.items()},
        "lower_body_array": array,
        "lower_body_powers": lower_body_powers(array),
        "axes": {
            name: {
                "kind": "rotary" if axis.rotary else "linear",
                "unit": axis.unit,
                "range": [axis.low, axis.high],
                "direction": list(axis.direction),
                "origin_mm": list(axis.origin_mm),
                "side": sides[name],
            }
            for name, axis in ((name, machine.axes[name]) for name in machine.axis_names)
        },
        "terms": [
            {
                "name": term.name,
                "kind": term.kind,
                "class": classes[term.name],
                "unit": term.unit,
                "body": term.body + 1,
                "meaning": meaning(machine, term),
            }
            for term in machine.terms
        ],
    }
