"""Fields: how a motion term runs along its axis, as a short Chebyshev series.

E_k(p, t) = Σ_d c_kd(t) T_d(ξ), with ξ = -1 ... 1 over the axis' range; a location term is one coefficient.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.error_map import ErrorMap
from model.machine import Machine
from model.terms import DIRECTIONS
from model.transforms import Array

GRID_POINTS = 161
"""Knots of a tabulated motion term. Between them the map is linear; for a cubic with an amplitude of 100 µm (100 T₃)
that stays within 0.05 µm: its curvature is 24 at the ends, so the gap is 24/8 · (2/160)² of it."""


@dataclass(frozen=True)
class Fields:
    """The series of a machine's learned error terms.

    Attributes
    ----------
    machine : gives the axes' ranges
    terms : names of the terms that have coefficients
    degree : highest Chebyshev degree of a motion term
    """

    machine: Machine
    terms: tuple[str, ...]
    degree: int

    def widths(self) -> list[int]:
        """Return the number of coefficients of each term, in order."""
        return [self.degree + 1 if self.machine.term(t).kind == "motion" else 1 for t in self.terms]

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
        """Return φ of a term at positions of shape (m,) [mm], as an array of shape (m, width)."""
        described = self.machine.term(term)
        if described.kind == "location":
            return np.ones((len(positions), 1))
        axis = self.machine.axes[described.axis]
        xi = (2.0 * positions - axis.low - axis.high) / (axis.high - axis.low)
        return np.asarray(np.polynomial.chebyshev.chebvander(np.clip(xi, -1.0, 1.0), self.degree), dtype=float)

    def evaluate(self, coefficients: Array, q: Array) -> Array:
        """Return all K error terms [mm, rad] at positions q, each with its own coefficients.

        Parameters
        ----------
        coefficients : shape (n, size) [µm, µrad]
        q : shape (n, A) [mm]

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

    def tabulate(self, coefficients: Array) -> ErrorMap:
        """Return the error map of coefficients of shape (size,) [µm, µrad], on a uniform grid of each axis."""
        slices = self.slices()
        knots: dict[str, Array] = {}
        motion: dict[str, Array] = {}
        for name, axis in self.machine.axes.items():
            knots[name] = np.linspace(axis.low, axis.high, GRID_POINTS)
            motion[name] = np.zeros((6, GRID_POINTS))
        location = np.zeros(len(self.machine.terms))
        for name, where in slices.items():
            term = self.machine.term(name)
            if term.kind == "location":
                location[self.machine.term_index[name]] = coefficients[where][0] * term.to_internal
            else:
                values = self.basis(name, knots[term.axis]) @ coefficients[where]
                motion[term.axis][DIRECTIONS.index(term.direction)] = values * term.to_internal
        return ErrorMap(self.machine, knots, motion, location[self.machine.location_columns])
