"""How far a predicted deviation may be off, at any position: half widths of 95 % intervals. Pure.

The bundle says it (`model/uncertainty.py`); to ask it at each position would cost more than the correction itself. So
the part that depends on position is tabulated once on a coarse grid, and what depends on the thermal state is one
factor per telemetry sample.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from model.chain import Chain
from model.error_map import ErrorMap
from model.terms import UM
from model.transforms import Array
from model.uncertainty import NORMAL_95, Uncertainty

NODES, FEW_NODES = 5, 3
"""Nodes along an axis of up to three, and of more: a table of 125 to 729. A cubic series is met within some percent."""
LONG_MM = 1000.0
"""A tool's length that stands for all [mm]: the tip's directions are affine in it, so two lengths give every one."""
FEW = 8
"""Positions up to which plain Python is faster than arrays."""
MOST_TOOLS = 64
"""Tools whose tables are kept: a magazine's."""


class Interval:
    """Half widths of 95 % intervals over the working volume of a machine with linear axes.

    Between the nodes the variance is linear, which is never below the true one where the deviation's directions are
    linear in position. Where they are not, the table is raised by the largest excess found in the middle of a cell.
    Of the three components the largest stands for all.

    Parameters
    ----------
    uncertainty : what the bundle says
    chain : of the same machine
    """

    def __init__(self, uncertainty: Uncertainty, chain: Chain) -> None:
        self._uncertainty, self._chain = uncertainty, chain
        axes = [chain.machine.axes[a] for a in chain.machine.axis_names]
        self._nodes = NODES if len(axes) <= 3 else FEW_NODES
        self._low = [axis.low for axis in axes]
        self._scale = [(self._nodes - 1) / (axis.high - axis.low) for axis in axes]
        self._strides = [self._nodes ** (len(axes) - 1 - k) for k in range(len(axes))]
        self._axes = [*zip(self._low, self._scale, self._strides, strict=True)]
        self._offsets = [0]
        for stride in self._strides:
            self._offsets += [o + stride for o in self._offsets]
        self._tables: dict[float | None, list[float]] = {}
        self._misfit = uncertainty.misfit_um**2

    def half_width_um(self, q: Array, tool_length_mm: float | None, spread: float) -> Array:
        """Return half the width of the interval at positions q (n, A), shape (n,) [µm].

        Parameters
        ----------
        tool_length_mm : None is the machine's own tool
        spread : how many times as far off as usual the prediction is in its present state
        """
        table = self._table(tool_length_mm)
        square, misfit = spread * spread, self._misfit
        if len(q) <= FEW:
            return np.array([NORMAL_95 * math.sqrt(square * self._at(table, p) + misfit) for p in q.tolist()])
        return NORMAL_95 * np.sqrt(square * self._at_all(table, q) + misfit)

    def _at(self, table: Sequence[float], position: Sequence[float]) -> float:
        """Return the variance at one position [µm²] for a spread of 1."""
        first, last = 0, self._nodes - 1
        shares = [1.0]  # of each corner of the cell, in the order of self._offsets
        for value, (low, scale, stride) in zip(position, self._axes, strict=True):
            at = (value - low) * scale
            at = 0.0 if at < 0.0 else last if at > last else at
            cell = int(at) if at < last else last - 1
            first += cell * stride
            high = at - cell
            shares = [s * (1.0 - high) for s in shares] + [s * high for s in shares]
        return sum([s * table[first + o] for s, o in zip(shares, self._offsets, strict=True)])

    def _at_all(self, table: Sequence[float], q: Array) -> Array:
        """Return the variance at positions (n, A), shape (n,): what `_at` does, at once."""
        at = np.clip((q - self._low) * self._scale, 0.0, self._nodes - 1.0)
        cell = np.minimum(at.astype(int), self._nodes - 2)
        high, first, values = at - cell, cell @ np.array(self._strides), np.array(table)
        shares = np.ones((1, len(q)))
        for column in high.T:
            shares = np.concatenate([shares * (1.0 - column), shares * column])
        found: Array = sum(s * values[first + o] for s, o in zip(shares, self._offsets, strict=True))
        return found

    def _table(self, tool_length_mm: float | None) -> list[float]:
        """Return the variance at the nodes, in C order [µm²]."""
        if tool_length_mm not in self._tables:
            if len(self._tables) >= MOST_TOOLS:
                self._tables.clear()
            nodes, middles = self._variances(tool_length_mm)
            table = nodes.tolist()
            pairs = zip(middles.tolist(), self._middles.tolist(), strict=True)
            excess = max((m / self._at(table, p) for m, p in pairs if m > 0.0), default=1.0)
            self._tables[tool_length_mm] = (nodes * max(excess, 1.0)).tolist()
        return self._tables[tool_length_mm]

    def _variances(self, tool_length_mm: float | None) -> tuple[Array, Array]:
        """Return the largest component's variance at the nodes and at the cells' middles [µm²]."""
        if tool_length_mm is None:
            usual = self._uncertainty.usual_tip(np.vstack([self._grid, self._middles])) ** 2
        else:
            usual = _of_length(*self._by_length, tool_length_mm / LONG_MM)
        most = usual.max(axis=1)
        return most[: len(self._grid)], most[len(self._grid) :]

    @cached_property
    def _by_length(self) -> tuple[Array, Array, Array]:
        """Variances for tools of no length, of `LONG_MM` and twice that, each of shape (n, 3): they fix a parabola."""
        direction, q = np.asarray(self._chain.machine.tool.direction), np.vstack([self._grid, self._middles])
        none, long, longer = (self._uncertainty.usual_tip(q, k * LONG_MM * direction) ** 2 for k in (0.0, 1.0, 2.0))
        return none, long, longer

    @cached_property
    def _grid(self) -> Array:
        return self._points(np.arange(self._nodes, dtype=float))

    @cached_property
    def _middles(self) -> Array:
        return self._points(np.arange(self._nodes - 1, dtype=float) + 0.5)

    def _points(self, steps: Array) -> Array:
        columns = [low + steps / scale for low, scale in zip(self._low, self._scale, strict=True)]
        return np.array([*itertools.product(*columns)])


def unapplied_um(chain: Chain, q: Array, thermal: ErrorMap, weight: float, tool_mm: Array | None) -> Array:
    """Return what the weight of the thermal part leaves out of the deviation at q (n, A), shape (n,) [µm].

    The largest component, as `Interval`; `weight` from 0 to 1.
    """
    left_out = np.einsum("nik,nk->ni", chain.sensitivity(q, tool_mm)[:, :3], thermal.evaluate(q))
    found: Array = np.abs(left_out).max(axis=1) * (1.0 - weight) / UM
    return found


def relative_spread(now: float, at_datum: float) -> float:
    """Return the spread of a change since a datum: both states are off, and not in the same way."""
    return math.hypot(now, at_datum)


def _of_length(none: Array, long: Array, longer: Array, length: float) -> Array:
    """Return the parabola through 0, 1 and 2, never below zero."""
    bent = (longer - 2.0 * long + none) / 2.0
    value: Array = none + (long - none - bent) * length + bent * length**2
    return np.maximum(value, 0.0)
