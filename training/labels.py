"""From measured error terms at positions to the coefficients of the fields, the network's targets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.fields import Fields
from model.transforms import Array
from training.coverage import Coverage, by_pattern

SMOOTHNESS = 1e-4
"""Penalty of a coefficient, times its degree to the fourth (the energy of bending), beside the mean square of the
measured positions. It decides only what the positions leave open, such as a cubic through three points."""


def to_coefficients(values: Array, coverage: Coverage, fields: Fields) -> Array:
    """Return the coefficients (N, P) of measured columns (N, J), NaN for terms that a time does not show.

    Each term is fitted by least squares to the positions measured at that time.
    """
    coefficients = np.full((len(values), fields.size), np.nan)
    for name, where in fields.slices().items():
        if name not in coverage:
            continue
        reach = coverage[name]
        known = np.isfinite(values[:, reach.columns])
        shown = np.flatnonzero(reach.shown(known))
        basis = fields.basis(name, reach.positions)
        for pattern, rows in by_pattern(known[shown]):
            measured = values[np.ix_(shown[rows], reach.columns[pattern])]
            coefficients[shown[rows], where] = measured @ _fit(basis[pattern]).T
    return coefficients


def _fit(basis: Array) -> Array:
    """Return the matrix that maps values at positions to coefficients, shape (width, m)."""
    degrees = np.arange(basis.shape[1], dtype=float)
    penalty = np.diag(SMOOTHNESS * degrees**4 * len(basis))
    return np.asarray(np.linalg.lstsq(basis.T @ basis + penalty, basis.T, rcond=1e-12)[0], dtype=float)


def patterns(known: NDArray[np.bool_]) -> list[tuple[NDArray[np.bool_], NDArray[np.intp]]]:
    """Return the distinct sets of rows (N,) in which columns of `known` (N, P) are known, and which columns."""
    sets, which = np.unique(known, axis=1, return_inverse=True)
    return [(rows, np.flatnonzero(which.ravel() == i)) for i, rows in enumerate(sets.T)]
