"""Linear least squares that knows what it cannot know."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.transforms import Array

RELATIVE = 1e-6
"""Singular values below this part of the largest count as zero: such a combination of coefficients would have to be
a million times larger than the best determined one to show equally in the measurement."""
TOUCHED = 1e-6
"""Part of a coefficient that must lie in the null space for it to count as undetermined."""


@dataclass(frozen=True)
class Solution:
    """Coefficients and how well they are known.

    Attributes
    ----------
    coefficients : shape (p,); of all that fit equally well, the smallest
    covariance : shape (p, p), of what the data determine; NaN where the spread of the data is not known
    spread : standard deviation of the residuals over their stated uncertainty, NaN without spare equations
    """

    coefficients: Array
    covariance: Array
    spread: float


class LeastSquares:
    """The weighted equations `design @ c = values`, decomposed once.

    Parameters
    ----------
    design : shape (m, p)
    sigma : standard uncertainty of the values, shape (m,), up to a common factor
    absolute : whether that factor is 1, for when there are no spare equations whose residuals give it

    Attributes
    ----------
    visible, null : orthonormal bases of the combinations of coefficients that the equations determine, shape
        (p, rank), and of those that they do not, shape (p, p - rank)
    freedom : number of spare equations
    """

    def __init__(self, design: Array, sigma: Array, *, absolute: bool = False) -> None:
        self._sigma, self._absolute = sigma, absolute
        count = design.shape[1]
        self._weighted = design / sigma[:, None]
        # Rows of zeros, where equations are fewer than coefficients, make the decomposition hold the null space.
        padded = np.concatenate([self._weighted, np.zeros((max(count - len(design), 0), count))])
        u, s, vt = np.linalg.svd(padded, full_matrices=False)
        self.rank = int((s > RELATIVE * s.max(initial=0.0)).sum())
        self._u, self._s = u[: len(design), : self.rank], s[: self.rank]
        self.visible: Array = vt[: self.rank].T
        self.null: Array = vt[self.rank :].T
        self.freedom = len(design) - self.rank

    @property
    def determined(self) -> NDArray[np.bool_]:
        """Whether the data determine each coefficient by itself, shape (p,)."""
        return np.asarray(np.linalg.norm(self.null, axis=1) < TOUCHED)

    def identifiable_part(self, coefficients: Array) -> Array:
        """Return the part of coefficients (p,) that the data can see."""
        return np.asarray(coefficients - self.null @ (self.null.T @ coefficients), dtype=float)

    def solve(self, values: Array) -> Solution:
        """Return the coefficients for values of shape (m,)."""
        scaled = values / self._sigma
        found: Array = self.visible @ ((self._u.T @ scaled) / self._s)
        missed = float(np.square(scaled - self._weighted @ found).sum())
        spread = float(np.sqrt(missed / self.freedom)) if self.freedom > 0 else np.nan
        factor = 1.0 if self._absolute and self.freedom <= 0 else spread
        half = self.visible / self._s * factor
        return Solution(found, np.asarray(half @ half.T, dtype=float), spread)
