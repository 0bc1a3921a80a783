"""Estimate a sensor's reading from the others, for a sensor that is missing or implausible."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.exceptions import DataError
from model.transforms import Array

NOISE_DEGC = 0.1
"""Standard deviation of what a sensor does not share with the others [°C] (chosen: a good Pt100 channel). It keeps
the estimate from leaning on differences that are noise."""


@dataclass(frozen=True)
class SensorModel:
    """Joint normal distribution of a machine's temperatures.

    Attributes
    ----------
    mean : shape (S,) [°C]
    covariance : shape (S, S) [K²]
    """

    mean: Array
    covariance: Array

    @classmethod
    def fit(cls, temperatures: Array) -> SensorModel:
        """Estimate it from readings of shape (n, S), NaN where missing.

        Each pair of sensors counts the samples that have both. With gaps this need not be a covariance of anything,
        so its correlations are brought to the nearest ones that are.

        Raises
        ------
        DataError
            where a sensor has no reading at all.
        """
        known = np.isfinite(temperatures)
        if not known.any(axis=0).all():
            raise DataError(f"each sensor must have readings, got none in column {int(np.argmin(known.any(axis=0)))}")
        count = known.sum(axis=0)
        mean = np.where(known, temperatures, 0.0).sum(axis=0) / count
        centred = np.where(known, temperatures - mean, 0.0)
        together = np.maximum(known.T.astype(float) @ known.astype(float), 1.0)
        covariance = centred.T @ centred / together
        return cls(mean, covariance if known.all() else _semidefinite(covariance))

    def fill(self, temperatures: Array) -> Array:
        """Replace NaN by the conditional mean given the other sensors.

        Parameters
        ----------
        temperatures : shape (n, S) or (S,) [°C]

        Returns
        -------
        array of the same shape without NaN; the mean, where all sensors of a sample are missing
        """
        filled: Array = np.array(temperatures, dtype=float, ndmin=2)
        missing = ~np.isfinite(filled)
        if not missing.any():
            return filled.reshape(np.shape(temperatures))
        # Faults last: few distinct patterns of missing sensors occur, so each is solved once.
        for pattern in np.unique(missing[missing.any(axis=1)], axis=0):
            rows = (missing == pattern).all(axis=1)
            filled[np.ix_(rows, pattern)] = self._estimate(filled[np.ix_(rows, ~pattern)], pattern)
        return filled.reshape(np.shape(temperatures))

    def _estimate(self, known: Array, pattern: NDArray[np.bool_]) -> Array:
        total = self.covariance + NOISE_DEGC**2 * np.eye(len(self.mean))
        gain = np.linalg.solve(total[np.ix_(~pattern, ~pattern)], total[np.ix_(~pattern, pattern)])
        estimate: Array = self.mean[pattern] + (known - self.mean[~pattern]) @ gain
        return estimate


def _semidefinite(covariance: Array) -> Array:
    """Return it without negative eigenvalues of the correlations; variances stay (Rebonato and Jäckel, 1999)."""
    deviation = np.sqrt(np.diag(covariance))
    unit = np.where(deviation > 0, deviation, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    half = vectors * np.sqrt(np.maximum(values, 0.0))
    size = np.linalg.norm(half, axis=1)
    half *= (deviation / np.where(size > 0, size, 1.0))[:, None]
    return np.asarray(half @ half.T, dtype=float)


def is_covariance(matrix: Array) -> bool:
    """Say whether a matrix of shape (S, S) is finite, symmetric and, but for rounding, positive semidefinite."""
    if not matrix.size:
        return True
    if not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T, rtol=1e-9, atol=1e-12):
        return False
    values = np.linalg.eigvalsh(matrix)
    return bool(values[0] >= -1e-9 * max(float(values[-1]), 1e-9))
