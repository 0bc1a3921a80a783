"""Error terms from measured deviations of the tool: linear least squares on δ = G(q) Φ(q) c.

Motion terms are short Chebyshev series in their axis' position (`model.fields`), location terms constants. What is
linear is the first order of the chain: errors of 100 µm and 100 µrad leave out some 0.01 µm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.ambiguity import Ambiguities, find_ambiguities
from model.chain import Chain
from model.error_map import Row
from model.fields import GRID_POINTS, Fields
from model.least_squares import LeastSquares, Solution
from model.measurements import Measurements
from model.term_classes import principal_terms
from model.terms import UM, URAD
from model.transforms import Array

PARTS = ("constant", "linear part", "quadratic part", "cubic part")


@dataclass(frozen=True)
class Coefficient:
    """One coefficient of one term's series.

    Attributes
    ----------
    name : "EC0Y", "EXX's constant"
    value : [µm, µrad]
    standard_error : the same; None where the measurement does not determine it, or not its uncertainty
    """

    name: str
    term: str
    degree: int
    value: float
    standard_error: float | None
    determined: bool


@dataclass(frozen=True)
class Identification:
    """What measurements say about the error terms.

    Attributes
    ----------
    solution : coefficients in the order of `fields`, with their covariance
    coefficients : the same, named
    ambiguities : which coefficients the measurements do not separate
    equations, rank : how many numbers were measured, and how many combinations of coefficients they determine
    spans : by axis, the lowest and highest coordinate measured at
    residual_um, residual_urad : root mean square of the residuals, None where nothing of that kind was measured
    """

    fields: Fields
    solution: Solution
    coefficients: tuple[Coefficient, ...]
    ambiguities: Ambiguities
    equations: int
    rank: int
    spans: dict[str, tuple[float, float]]
    residual_um: float | None
    residual_urad: float | None

    def rows(self) -> list[Row]:
        """Return the identified terms as an error table [µm, µrad].

        It spans what was measured of each axis, and so is constant beyond: a polynomial must not be continued.
        """
        rows: list[Row] = []
        for term, where in self.fields.slices().items():
            positions = self._positions(term)
            values = self.fields.basis(term, positions) @ self.solution.coefficients[where]
            at = positions.tolist() if self.fields.machine.term(term).kind == "motion" else [None]
            rows += [(term, p, float(v)) for p, v in zip(at, values, strict=True)]
        return rows

    def summary(self, term: str) -> tuple[float, float | None]:
        """Return a term's value and its standard error, as root mean squares over the measured span of its axis.

        The standard error is that of the coefficients that the measurement determines, None where there are none.
        """
        where = self.fields.slices()[term]
        basis = self.fields.basis(term, self._positions(term))
        value = float(np.sqrt(np.mean(np.square(basis @ self.solution.coefficients[where]))))
        known = np.array([c.standard_error is not None for c in self.coefficients[where]])
        if not known.any():
            return value, None
        covariance = self.solution.covariance[where, where][np.ix_(known, known)]
        variance = np.einsum("ni,ij,nj->n", basis[:, known], covariance, basis[:, known])
        return value, float(np.sqrt(variance.mean()))

    def _positions(self, term: str) -> Array:
        described = self.fields.machine.term(term)
        if described.kind == "location":
            return np.zeros(1)
        low, high = self.spans[described.axis]
        return np.linspace(low, high, GRID_POINTS) if low < high else np.array([low])


def design_matrix(chain: Chain, measurements: Measurements, fields: Fields) -> Array:
    """Return what each coefficient adds to each measured number, shape (m, p) [µm, µrad]."""
    machine = chain.machine
    sensitivity = np.empty((len(measurements.q), 6, len(machine.terms)))
    tips, which = np.unique(measurements.tool_mm, axis=0, return_inverse=True)
    for index, tip in enumerate(tips):
        rows = np.flatnonzero(which.ravel() == index)
        sensitivity[rows] = chain.sensitivity(measurements.q[rows], tip)
    at = measurements.position
    by_term = np.einsum("mi,mik->mk", measurements.functional, sensitivity[at])
    by_term *= np.array([t.to_internal for t in machine.terms])
    by_term /= np.where(measurements.angular, URAD, UM)[:, None]
    design = np.empty((len(measurements), fields.size))
    for name, where in fields.slices().items():
        term = machine.term(name)
        column = 0 if term.kind == "location" else machine.axis_names.index(term.axis)
        series = fields.basis(name, measurements.q[:, column])
        design[:, where] = by_term[:, [machine.term_index[name]]] * series[at]
    return design


def identify(chain: Chain, measurements: Measurements, fields: Fields) -> Identification:
    """Estimate the coefficients of the fields' terms from measurements.

    Of all coefficients that fit equally well, the smallest in the sum of squares [µm², µrad²] are returned: where a
    measurement does not separate terms, they share the effect. The deviation that they predict is the same.
    """
    design = design_matrix(chain, measurements, fields)
    equations = LeastSquares(design, measurements.sigma, absolute=measurements.absolute)
    solution = equations.solve(measurements.value)
    measured = measurements.q[measurements.position]
    residual = measurements.value - design @ solution.coefficients
    degrees = [(t, d) for t, width in zip(fields.terms, fields.widths(), strict=True) for d in range(width)]
    errors = np.sqrt(np.maximum(np.diag(solution.covariance), 0.0))
    coefficients = tuple(
        Coefficient(
            _name(fields, term, degree),
            term,
            degree,
            float(solution.coefficients[i]),
            float(errors[i]) if equations.determined[i] and np.isfinite(errors[i]) else None,
            bool(equations.determined[i]),
        )
        for i, (term, degree) in enumerate(degrees)
    )
    return Identification(
        fields,
        solution,
        coefficients,
        find_ambiguities(equations.visible, _least_important_first(fields, degrees)),
        len(measurements),
        equations.rank,
        {a: (float(measured[:, i].min()), float(measured[:, i].max())) for i, a in enumerate(chain.machine.axis_names)},
        _rms(residual[~measurements.angular]),
        _rms(residual[measurements.angular]),
    )


def _least_important_first(fields: Fields, degrees: list[tuple[str, int]]) -> list[int]:
    """Return the order in which coefficients are traded: secondary terms, then other constants, then the rest."""
    principal = principal_terms(fields.machine)
    return sorted(range(len(degrees)), key=lambda i: (degrees[i][0] in principal, degrees[i][1], -i))


def _name(fields: Fields, term: str, degree: int) -> str:
    if fields.machine.term(term).kind == "location":
        return term
    return f"{term}'s {PARTS[degree] if degree < len(PARTS) else f'part of degree {degree}'}"


def _rms(residual: Array) -> float | None:
    return float(np.sqrt(np.mean(np.square(residual)))) if len(residual) else None
