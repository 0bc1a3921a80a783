"""How something rigid rests on one or two places that move.

On one place it moves and turns with it. On two, its turns about the lines across come from the difference of their
shifts, its turn about their own line is the mean. What the two disagree on along their own line, a bridge that grows
between walls that do not, is slack: nothing is squeezed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_synth.beam import Vector
from data_synth.displacement import Displacement
from data_synth.network import Array
from model.exceptions import MachineError


@dataclass(frozen=True)
class Foot:
    """A point of a body [mm].

    Attributes
    ----------
    on : the part of the body that the point belongs to; "" is its first
    hold : share, of two feet, that this one holds along the line between them; (1, 0) is a fixed and a floating one
    """

    at_mm: Vector
    on: str = ""
    hold: float = 1.0


def middle(feet: Sequence[Foot]) -> Array:
    """Return the mean place of the feet, shape (3,) [mm]."""
    place: Array = np.array([foot.at_mm for foot in feet], dtype=np.float64).mean(axis=0)
    return place


def rest(feet: Sequence[Foot], moved: Sequence[Displacement], free: Array | None = None) -> Displacement:
    """Return the displacement, at the middle of the feet, of what rests on them.

    Parameters
    ----------
    moved : the displacement of each foot
    free : a direction (3,) in which the feet do not hold it, so that it takes no turn from their difference there
    """
    if len(feet) == 1:
        return moved[0]
    if len(feet) != 2:
        raise MachineError(f"a part must rest on one or two places, got {len(feet)}; join them into two")
    first, second = moved
    apart = np.subtract(feet[1].at_mm, feet[0].at_mm)
    length = float(np.linalg.norm(apart))
    if length == 0.0:
        raise MachineError(f"the two places a part rests on must lie apart, got {feet[0].at_mm} twice; give one")
    u = apart / length
    weight = feet[1].hold / (feet[0].hold + feet[1].hold)
    shift, turn = (first.shift + second.shift) / 2, (first.turn + second.turn) / 2
    difference = second.shift - first.shift
    # Held along the line by their shares, not evenly.
    shift = shift + (weight - 0.5) * u[:, None] * (difference * u[:, None]).sum(axis=1, keepdims=True)
    for across in _across(u, free):
        about = np.cross(u, across)
        wanted = (difference * across[:, None]).sum(axis=1, keepdims=True) / length
        turn = turn + about[:, None] * (wanted - (turn * about[:, None]).sum(axis=1, keepdims=True))
    return Displacement(shift, turn)


def _across(u: Array, free: Array | None) -> list[Array]:
    """Return the unit vectors across u in which a difference of the feet's shifts turns what rests on them."""
    hint = np.eye(3)[np.argmin(np.abs(u))] if free is None else free - (free @ u) * u
    if np.linalg.norm(hint) < 1e-9:  # free only along their own line
        return _across(u, None)
    first = hint - (hint @ u) * u
    first = first / np.linalg.norm(first)
    second = np.cross(u, first)
    return [first, second] if free is None else [second]
