"""Ridge regression for many penalties and left-out parts at once, from normal equations added up by part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.transforms import Array
from training.labels import patterns


@dataclass(frozen=True)
class Normal:
    """X'X, X'Y and Y'Y of rows of features and the targets that they have in common.

    Attributes
    ----------
    square : shape (p, p)
    product : shape (p, R)
    energy : sum of all squared targets
    """

    square: Array
    product: Array
    energy: float

    @classmethod
    def of(cls, x: Array, y: Array) -> Normal:
        """Return it for features (n, p) and targets (n, R)."""
        return cls(x.T @ x, x.T @ y, float((y**2).sum()))

    def __add__(self, other: Normal) -> Normal:
        return Normal(self.square + other.square, self.product + other.product, self.energy + other.energy)

    def __sub__(self, other: Normal) -> Normal:
        return Normal(self.square - other.square, self.product - other.product, self.energy - other.energy)

    def of_columns(self, columns: NDArray[np.intp]) -> Normal:
        """Return it for some of the features."""
        return Normal(self.square[np.ix_(columns, columns)], self.product[columns], self.energy)

    def solve(self, penalties: Array, free: NDArray[np.bool_]) -> Array:
        """Return the ridge weights (len(penalties), p, R); features where `free` are not penalised."""
        tied = ~free
        # Free features are few (an intercept, own past values): eliminated first, so that one eigendecomposition of
        # the rest serves all penalties. Their own tiny damping serves features that never move.
        own = self.square[np.ix_(free, free)]
        own = own + 1e-10 * max(float(np.trace(own)), 1e-6) * np.eye(len(own))
        cross = self.square[np.ix_(free, tied)]
        lift = np.linalg.solve(own, cross) if len(own) else cross
        values, vectors = np.linalg.eigh(self.square[np.ix_(tied, tied)] - cross.T @ lift)
        wanted = vectors.T @ (self.product[tied] - lift.T @ self.product[free])
        shrunk = wanted / (np.maximum(values, 0.0) + penalties[:, None])[:, :, None]
        weights = np.zeros((len(penalties), *self.product.shape))
        weights[:, tied] = vectors @ shrunk
        if len(own):
            weights[:, free] = np.linalg.solve(own, self.product[free]) - lift @ weights[:, tied]
        return weights

    def left(self, weights: Array) -> Array:
        """Return the summed squares (k,) that weights (k, p, R) leave of these targets."""
        fitted = np.einsum("kpr,kpr->k", weights, self.square @ weights - 2.0 * self.product)
        found: Array = np.maximum(self.energy + fitted, 0.0)
        return found


def by_part(x: Array, y: Array, part: NDArray[np.intp]) -> list[list[Normal]]:
    """Return the normal equations of each part (inner), for each set of targets known together (outer).

    Targets (n, R) have NaN where not known.
    """
    return [
        [Normal.of(x[rows & (part == k)], y[np.ix_(rows & (part == k), columns)]) for k in np.unique(part)]
        for rows, columns in patterns(np.isfinite(y))
        if rows.any()
    ]


def left_out_errors(blocks: list[list[Normal]], penalties: Array, free: NDArray[np.bool_]) -> Array:
    """Return the summed squares (len(penalties),) that ridge regression leaves of each part, fitted to the others."""
    errors = np.zeros(len(penalties))
    for block in blocks:
        whole = sum(block[1:], block[0])
        for part in block if len(block) > 1 else []:
            errors += part.left((whole - part).solve(penalties, free))
    return errors
