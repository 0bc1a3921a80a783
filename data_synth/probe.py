"""What a touch probe would measure on the way: deviations of the tool tip at positions in the working volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_synth.fields import Terms
from data_synth.network import Array
from model.chain import Chain
from model.error_map import ErrorMap
from model.machine import Machine
from model.terms import DIRECTIONS

TOUCH_STREAM = 1
"""Beside seed and run, so that the run is the same with and without a probe."""
TOUCHES = 4  # at each time of the error terms (chosen)
NOISE_UM = 0.5
"""Spread of each coordinate (chosen): data sheets of touch probes state a repeatability of 1 µm at two sigma."""
POSITION_STEP, SHOWN_UM = 1e-3, 0.01  # positions are commanded to a micrometre; results are shown to 10 nm


@dataclass(frozen=True)
class Touches:
    """m measurements.

    Attributes
    ----------
    time_s : shape (m,)
    q : shape (m, A), in the machine's order of axes [mm, degree]
    deviation_um : shape (m, 3), in the workpiece frame
    """

    time_s: Array
    q: Array
    deviation_um: Array


def probe(machine: Machine, time_s: Array, terms: Terms, cold: ErrorMap, rng: np.random.Generator) -> Touches:
    """Return some measurements at each of the times (t,), at positions drawn anew over the whole working volume.

    Hot and cold errors together, by the exact chain, as the machine has both; without the errors of axes not given.
    """
    q = positions(machine, TOUCHES * len(time_s), rng)
    at = np.repeat(np.arange(len(time_s)), TOUCHES)
    e = errors_at(machine, terms, at, q) + cold.evaluate(q)
    exact = 1e3 * Chain(machine).deviation(q, e).position_mm
    noisy = exact + rng.normal(0.0, NOISE_UM, exact.shape)
    return Touches(time_s[at], q, np.round(noisy / SHOWN_UM) * SHOWN_UM + 0.0)


def positions(machine: Machine, n: int, rng: np.random.Generator) -> Array:
    """Return positions drawn uniformly over the axes' ranges, shape (n, A) [mm, degree]."""
    axes = [machine.axes[name] for name in machine.axis_names]
    low, high = np.array([axis.low for axis in axes]), np.array([axis.high for axis in axes])
    drawn: Array = np.round(rng.uniform(low, high, (n, len(axes))) / POSITION_STEP) * POSITION_STEP
    return np.clip(drawn, low, high)


def errors_at(machine: Machine, terms: Terms, at: NDArray[np.intp], q: Array) -> Array:
    """Return all terms at samples `at` (n,) and positions `q` (n, A), linear between their positions.

    Returns
    -------
    shape (n, K), in the machine's order of terms [mm, rad]
    """
    e = np.zeros((len(q), len(machine.terms)))
    for k, term in enumerate(machine.terms):
        row = DIRECTIONS.index(term.direction)
        if term.kind == "location":
            e[:, k] = term.to_internal * terms.location[term.axis][at, row]
            continue
        knots, values = terms.positions[term.axis], terms.motion[term.axis][:, row]
        place = q[:, machine.axis_names.index(term.axis)]
        left = np.clip(np.searchsorted(knots, place, side="right") - 1, 0, len(knots) - 2)
        weight = np.clip((place - knots[left]) / (knots[left + 1] - knots[left]), 0.0, 1.0)
        e[:, k] = term.to_internal * (values[at, left] * (1.0 - weight) + values[at, left + 1] * weight)
    return e
