"""How far a run moves the tool tip: the first-order chain over the error terms."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from data_synth.fields import Terms
from data_synth.network import Array
from model.chain import Chain
from model.machine import Machine

PLACES = 3  # positions per axis: both ends and the middle of its range; a rotary axis at most a quarter turn away


def tip_deviation(machine: Machine, terms: Terms) -> Array:
    """Return the tip's deviation in the workpiece frame over time, at ends and middles of the working volume.

    Returns
    -------
    shape (t, places, 3) [µm]; the middle of the volume is the middle place
    """
    at = {axis: _places(p, machine.axes[axis].rotary) for axis, p in terms.positions.items()}
    grid = list(product(*(at[axis] for axis in machine.axis_names)))
    q = np.array([[terms.positions[a][i] for a, i in zip(machine.axis_names, place, strict=True)] for place in grid])
    by_term = Chain(machine).sensitivity(q)[:, :3]  # (places, 3, K)
    # One product of all columns of error terms with what each does at each place.
    values, weights = [], []
    for k, term in enumerate(machine.terms):
        row = "XYZABC".index(term.direction)
        effect = 1e3 * term.to_internal * by_term[:, :, k]  # (places, 3)
        if term.kind == "location":
            values.append(terms.location[term.axis][:, row, None])
            weights.append(effect[None])
        else:
            here = np.array([place[machine.axis_names.index(term.axis)] for place in grid])
            used = np.unique(here)
            values.append(terms.motion[term.axis][:, row][:, used])
            weights.append(np.where((here == used[:, None])[..., None], effect, 0.0))
    deviation: Array = np.tensordot(np.concatenate(values, axis=1), np.concatenate(weights), 1)
    return deviation


def _places(positions: Array, rotary: bool) -> NDArray[np.intp]:
    """Return which of an axis' positions are looked at; a turn's two ends are one place and would show nothing."""
    if not rotary:
        return np.linspace(0, len(positions) - 1, PLACES).astype(np.intp)
    middle = (positions[0] + positions[-1]) / 2
    reach = min(90.0, positions[-1] - middle)
    wanted = np.linspace(middle - reach, middle + reach, PLACES)
    near: NDArray[np.intp] = np.abs(positions[:, None] - wanted).argmin(axis=0)
    return near
