"""The error map: every error term, piecewise linear over its axis.

It is the sum of measured geometric tables and the thermal prediction, and all that the per-position code needs.
Linear between its knots and constant beyond them, as controllers treat their tables.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from model.exceptions import DataError
from model.machine import Machine
from model.terms import DIRECTIONS
from model.transforms import Array

Row = tuple[str, float | None, float]
"""One line of an error table: term, position [mm] (None for location terms), value [µm or µrad]."""


@dataclass(frozen=True)
class ErrorMap:
    """Error terms of a machine over its axes, in mm and rad.

    Attributes
    ----------
    machine : gives the order of the terms
    knots : per axis, positions in rising order, shape (m,) [mm]
    motion : per axis, its six motion terms at the knots, shape (6, m)
    location : the location terms in the order in which they stand in `machine.terms`, shape (L,)
    """

    machine: Machine
    knots: Mapping[str, Array]
    motion: Mapping[str, Array]
    location: Array

    @classmethod
    def zero(cls, machine: Machine) -> ErrorMap:
        """Return the map without errors."""
        knots = {a: np.array([machine.axes[a].low]) for a in machine.axis_names}
        motion = {a: np.zeros((6, 1)) for a in machine.axis_names}
        return cls(machine, knots, motion, np.zeros(len(machine.location_columns)))

    @classmethod
    def from_rows(cls, machine: Machine, rows: Iterable[Row], where: str = "error table") -> ErrorMap:
        """Build the map of an error table; terms it does not name are zero.

        Raises
        ------
        DataError
            for a term the machine does not have, a position given twice, missing or superfluous, or a value
            that is not finite.
        """
        motion_rows: dict[str, dict[float, float]] = {}
        location = np.zeros(len(machine.terms))
        seen: set[str] = set()
        for number, (written, position, value) in enumerate(rows, start=1):
            at = f"{where}, row {number}"
            try:
                term = machine.term(written)
            except ValueError as problem:
                raise DataError(f"{at}: {problem}") from None
            if not math.isfinite(value):
                raise DataError(f"{at}: value of {term.name} must be finite, got {value}")
            if term.kind == "location":
                if position is not None:
                    raise DataError(f"{at}: {term.name} is a location term; leave its position empty, got {position:g}")
                if term.name in seen:
                    raise DataError(f"{at}: {term.name} stands twice; keep one row")
                seen.add(term.name)
                location[machine.term_index[term.name]] = value * term.to_internal
                continue
            if position is None or not math.isfinite(position):
                raise DataError(f"{at}: {term.name} is a motion term; give the position on axis {term.axis}")
            table = motion_rows.setdefault(term.name, {})
            if position in table:
                raise DataError(f"{at}: {term.name} has position {position:g} twice; keep one row")
            table[position] = value * term.to_internal
        return cls._from_tables(machine, motion_rows, location[machine.location_columns])

    @classmethod
    def _from_tables(cls, machine: Machine, tables: Mapping[str, Mapping[float, float]], location: Array) -> ErrorMap:
        knots: dict[str, Array] = {}
        motion: dict[str, Array] = {}
        for axis in machine.axis_names:
            names = [f"E{d}{axis}" for d in DIRECTIONS]
            positions = sorted({p for name in names for p in tables.get(name, {})}) or [machine.axes[axis].low]
            knots[axis] = np.asarray(positions)
            motion[axis] = np.stack([_sample(tables.get(name, {}), knots[axis]) for name in names])
        return cls(machine, knots, motion, location)

    def evaluate(self, q: Array) -> Array:
        """Return all error terms at positions q of shape (n, A), as an array of shape (n, K) [mm, rad]."""
        e = np.empty((len(q), len(self.machine.terms)))
        e[:, self.machine.location_columns] = self.location
        for axis in self.machine.axis_names:
            left, weight, _ = self._segments(axis, q)
            values = self.motion[axis]
            right = np.minimum(left + 1, values.shape[1] - 1)
            e[:, self.machine.motion_columns[axis]] = (values[:, left] * (1.0 - weight) + values[:, right] * weight).T
        return e

    def slopes(self, q: Array) -> Array:
        """Return the derivative of each term by its own axis' position, shape (n, K); zero for location terms."""
        slopes = np.zeros((len(q), len(self.machine.terms)))
        for axis in self.machine.axis_names:
            left, _, width = self._segments(axis, q)
            values = self.motion[axis]
            right = np.minimum(left + 1, values.shape[1] - 1)
            inside = (q[:, self._column(axis)] >= self.knots[axis][0]) & (
                q[:, self._column(axis)] < self.knots[axis][-1]
            )
            slopes[:, self.machine.motion_columns[axis]] = ((values[:, right] - values[:, left]) / width * inside).T
        return slopes

    def __add__(self, other: ErrorMap) -> ErrorMap:
        """Return the sum, exact: on the union of both maps' knots."""
        knots: dict[str, Array] = {}
        motion: dict[str, Array] = {}
        for axis in self.machine.axis_names:
            a, b = self.knots[axis], other.knots[axis]
            if a is b or np.array_equal(a, b):
                knots[axis], motion[axis] = a, self.motion[axis] + other.motion[axis]
            else:
                knots[axis] = _union(_Same(a), _Same(b))
                motion[axis] = self._resampled(axis, knots[axis]) + other._resampled(axis, knots[axis])
        return ErrorMap(self.machine, knots, motion, self.location + other.location)

    def __sub__(self, other: ErrorMap) -> ErrorMap:
        """Return the difference, exact as the sum."""
        return self + other.scaled(-1.0)

    def scaled(self, factor: float) -> ErrorMap:
        """Return every term times `factor`."""
        motion = {axis: values * factor for axis, values in self.motion.items()}
        return ErrorMap(self.machine, self.knots, motion, self.location * factor)

    def rows(self) -> list[Row]:
        """Return the map as an error table [µm, µrad], the inverse of `from_rows`."""
        rows: list[Row] = []
        location = iter(self.location)
        for term in self.machine.terms:
            if term.kind == "location":
                rows.append((term.name, None, float(next(location)) / term.to_internal))
                continue
            values = self.motion[term.axis][DIRECTIONS.index(term.direction)]
            rows += [
                (term.name, float(p), float(v) / term.to_internal)
                for p, v in zip(self.knots[term.axis], values, strict=True)
            ]
        return rows

    def _resampled(self, axis: str, knots: Array) -> Array:
        return np.stack([np.interp(knots, self.knots[axis], values) for values in self.motion[axis]])

    def _column(self, axis: str) -> int:
        return self.machine.axis_names.index(axis)

    def _segments(self, axis: str, q: Array) -> tuple[NDArray[np.intp], Array, Array]:
        """Return each position's left knot, its weight towards the right one, and the segment's width [mm]."""
        knots = self.knots[axis]
        position = q[:, self._column(axis)]
        left = np.clip(np.searchsorted(knots, position, side="right") - 1, 0, max(len(knots) - 2, 0))
        width = np.diff(knots)[left] if len(knots) > 1 else np.ones_like(position)
        weight = np.clip((position - knots[left]) / width, 0.0, 1.0)
        return left, weight, width


class _Same:
    """Makes an array a key: equal where it is the same array, which stays alive as long as the key does."""

    def __init__(self, array: Array) -> None:
        self.array = array

    def __hash__(self) -> int:
        return id(self.array)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and other.array is self.array


@lru_cache(maxsize=512)
def _union(a: _Same, b: _Same) -> Array:
    """Return the union of two axes' knots: the same array for the same two, so that what is worked out for it holds."""
    return np.union1d(a.array, b.array)


def _sample(table: Mapping[float, float], knots: Array) -> Array:
    if not table:
        return np.zeros(len(knots))
    positions = sorted(table)
    return np.interp(knots, positions, [table[p] for p in positions])
