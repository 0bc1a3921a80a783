"""How far a run moves the tool tip: the first-order chain over the error terms."""

from __future__ import annotations

from itertools import product

import numpy as np

from data_synth.fields import Terms
from data_synth.network import Array
from model.chain import Chain
from model.machine import Machine

PLACES = 3  # positions per axis: both ends and the middle of its range


def tip_deviation(machine: Machine, terms: Terms) -> Array:
    """Return the tip's deviation in the workpiece frame over time, at ends and middles of the working volume.

    Returns
    -------
    shape (t, places, 3) [µm]; the middle of the volume is the middle place
    """
    at = {axis: np.linspace(0, len(p) - 1, PLACES).astype(np.intp) for axis, p in terms.positions_mm.items()}
    grid = list(product(*(at[axis] for axis in machine.axis_names)))
    q = np.array([[terms.positions_mm[a][i] for a, i in zip(machine.axis_names, place, strict=True)] for place in grid])
    by_term = Chain(machine).sensitivity(q)[:, :3]  # (places, 3, K)
    deviation = np.zeros((len(next(iter(terms.location.values()))), len(grid), 3))
    for k, term in enumerate(machine.terms):
        row = "XYZABC".index(term.direction)
        scale = 1e3 * term.to_internal
        if term.kind == "location":
            deviation += scale * terms.location[term.axis][:, row, None, None] * by_term[None, :, :, k]
        else:
            here = [place[machine.axis_names.index(term.axis)] for place in grid]
            deviation += scale * terms.motion[term.axis][:, row][:, here, None] * by_term[None, :, :, k]
    return deviation
