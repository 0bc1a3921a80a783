"""Fields: how a motion term runs along its axis, as a short series.

E_k(p, t) = Σ_d c_kd(t) φ_d(p): Chebyshev polynomials T_d(ξ), with ξ = -1 ... 1 over the axis' range; for a rotary
axis of half a turn or more 1, cos p, sin p, cos 2p, sin 2p ..., since what turns with a table comes once per turn. A
location term is one coefficient.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from model.error_map import ErrorMap
from model.machine import Axis, Machine
from model.terms import DIRECTIONS, Term
from model.transforms import Array

GRID_POINTS = 161
"""Knots of a tabulated motion term. Between them the map is linear; for a cubic with an amplitude of 100 µm (100 T₃)
that stays within 0.05 µm: its curvature is 24 at the ends, so the gap is 24/8 · (2/160)² of it."""
GRID_DEG = 2.0
"""Knots of a series of harmonics are at most so far apart: for an amplitude of 100 µm twice a turn the gap is
(2 GRID_DEG)²/8 of it, 0.06 µm."""
HALF_TURN_DEG = 180.0

_Ints = NDArray[np.int64]
_Grid = tuple[
    dict[str, Array],
    dict[str, tuple[list[int], _Ints, Array, Array]],
    tuple[list[int], _Ints, Array],
]
"""Knots by axis; by axis the directions that have terms, their coefficients' columns (t, width), what makes them mm or
rad (t, 1) and the series (width, m); the same of the location terms without a series."""


@dataclass(frozen=True)
class Fields:
    """The series of a machine's learned error terms.

    Attributes
    ----------
    machine : gives the axes' ranges
    terms : names of the terms that have coefficients
    degree : highest Chebyshev degree of a motion term; harmonics reach to half of it, rounded up
    """

    machine: Machine
    terms: tuple[str, ...]
    degree: int

    def widths(self) -> list[int]:
        """Return the number of coefficients of each term, in order."""
        return [self._width(self.machine.term(t)) for t in self.terms]

    @property
    def size(self) -> int:
        """Number of coefficients of all terms together."""
        return sum(self.widths())

    def slices(self) -> dict[str, slice]:
        """Return where each term's coefficients stand."""
        ends = np.cumsum(self.widths())
        return {
            term: slice(int(end) - width, int(end))
            for term, end, width in zip(self.terms, ends, self.widths(), strict=True)
        }

    def basis(self, term: str, positions: Array) -> Array:
        """Return φ of a term at positions of shape (m,) [mm, degree], as an array of shape (m, width)."""
        described = self.machine.term(term)
        if described.kind == "location":
            return np.ones((len(positions), 1))
        axis = self.machine.axes[described.axis]
        if turns(axis):
            angle = np.deg2rad(np.clip(positions, axis.low, axis.high))[:, None]
            harmonics = np.arange(1, self._harmonics + 1) * angle
            pairs = np.stack([np.cos(harmonics), np.sin(harmonics)], axis=-1).reshape(len(positions), -1)
            return np.concatenate([np.ones((len(positions), 1)), pairs], axis=1)
        xi = (2.0 * positions - axis.low - axis.high) / (axis.high - axis.low)
        return np.asarray(np.polynomial.chebyshev.chebvander(np.clip(xi, -1.0, 1.0), self.degree), dtype=float)

    @property
    def _harmonics(self) -> int:
        return (self.degree + 1) // 2

    def _width(self, term: Term) -> int:
        if term.kind == "location":
            return 1
        return 1 + 2 * self._harmonics if turns(self.machine.axes[term.axis]) else self.degree + 1

    def evaluate(self, coefficients: Array, q: Array) -> Array:
        """Return all K error terms [mm, rad] at positions q, each with its own coefficients.

        Parameters
        ----------
        coefficients : shape (n, size) [µm, µrad]
        q : shape (n, A) [mm, degree]

        Returns
        -------
        array of shape (n, K), zero for terms without coefficients
        """
        e = np.zeros((len(q), len(self.machine.terms)))
        for name, where in self.slices().items():
            term = self.machine.term(name)
            column = 0 if term.kind == "location" else self.machine.axis_names.index(term.axis)
            series = (self.basis(name, q[:, column]) * coefficients[:, where]).sum(axis=1)
            e[:, self.machine.term_index[name]] = series * term.to_internal
        return e

    def evaluate_each(self, coefficients: Array, q: Array) -> Array:
        """Return the error terms of each of r sets of coefficients at each position, shape (r, n, K) [mm, rad].

        Parameters
        ----------
        coefficients : shape (r, size) [µm, µrad]
        q : shape (n, A) [mm, degree]
        """
        e = np.zeros((len(coefficients), len(q), len(self.machine.terms)))
        for name, where in self.slices().items():
            term = self.machine.term(name)
            column = 0 if term.kind == "location" else self.machine.axis_names.index(term.axis)
            series = coefficients[:, where] @ self.basis(name, q[:, column]).T
            e[:, :, self.machine.term_index[name]] = series * term.to_internal
        return e

    def tabulate(self, coefficients: Array) -> ErrorMap:
        """Return the error map of coefficients of shape (size,) [µm, µrad], on a uniform grid of each axis."""
        knots, series, location = self._grid
        motion: dict[str, Array] = {}
        for axis, (rows, columns, factors, basis) in series.items():
            motion[axis] = np.zeros((len(DIRECTIONS), len(knots[axis])))
            motion[axis][rows] = (coefficients[columns] * factors) @ basis
        rows, columns, factors = location
        placed = np.zeros(len(self.machine.location_columns))
        placed[rows] = coefficients[columns] * factors
        return ErrorMap(self.machine, knots, motion, placed)

    @cached_property
    def _grid(self) -> _Grid:
        """The knots of each axis and the series there, worked out once: a map is wanted for every sample."""
        knots: dict[str, Array] = {}
        motion: dict[str, dict[int, tuple[slice, float]]] = {name: {} for name in self.machine.axes}
        location: list[tuple[int, int, float]] = []
        for name, axis in self.machine.axes.items():
            points = int(np.ceil((axis.high - axis.low) / GRID_DEG)) + 1 if turns(axis) else 0
            knots[name] = np.linspace(axis.low, axis.high, max(points, GRID_POINTS))
        for name, where in self.slices().items():
            term = self.machine.term(name)
            if term.kind == "location":
                row = self.machine.location_columns.index(self.machine.term_index[name])
                location.append((row, where.start, term.to_internal))
            else:
                motion[term.axis][DIRECTIONS.index(term.direction)] = (where, term.to_internal)
        series = {}
        for name, terms in motion.items():
            if terms:
                first = f"E{DIRECTIONS[next(iter(terms))]}{name}"
                columns = np.array([range(where.start, where.stop) for where, _ in terms.values()])
                factors = np.array([[factor] for _, factor in terms.values()])
                series[name] = (list(terms), columns, factors, self.basis(first, knots[name]).T)
            else:
                series[name] = ([], np.zeros((0, 1), dtype=int), np.zeros((0, 1)), np.zeros((1, len(knots[name]))))
        rows, columns_of, factors_of = zip(*location, strict=True) if location else ((), (), ())
        at = np.array(columns_of, dtype=int)
        return knots, series, (list(rows), at, np.array(factors_of, dtype=float))


def turns(axis: Axis) -> bool:
    """Return whether an axis' terms are a series of harmonics: it is rotary and reaches half a turn."""
    return axis.rotary and axis.high - axis.low >= HALF_TURN_DEG
