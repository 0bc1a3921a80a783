"""Principal components of the terms, in the measure of the tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.transforms import Array
from training.labels import patterns

LOST = 1e-4
"""Share of the tip's mean square that the components may lose: 1 % of its root (chosen)."""
MOST = 10
"""Components, at most (chosen); the terms of three axes have six to eight."""
FLOOR = 1e-6
"""Least eigenvalue of the tip's quadratic form, of its largest: directions that do not move the tip."""


@dataclass(frozen=True)
class Components:
    """A few scores [µm at the tip] instead of the terms on the metric's grid.

    Terms that are always measured together share their components; a sum of squared scores is what they move the tip
    by, in the mean over the working volume.

    Attributes
    ----------
    blocks : columns of the grid that were measured together, shape (g,)
    to_scores : per block, shape (g, r)
    to_grid : shape (R, G), R the scores of all blocks
    """

    blocks: list[NDArray[np.intp]]
    to_scores: list[Array]
    to_grid: Array

    @classmethod
    def of(cls, values: Array, gram: Array) -> Components:
        """Return the components of terms on the grid (N, G), NaN where not measured; gram is that of the metric."""
        blocks: list[NDArray[np.intp]] = []
        to_scores: list[Array] = []
        to_grid: list[Array] = []
        for rows, columns in patterns(np.isfinite(values)):
            if not rows.any():
                continue
            size, vectors = np.linalg.eigh(gram[np.ix_(columns, columns)])
            root = np.sqrt(np.maximum(size, max(FLOOR * size[-1], 1e-12)))
            drift = values[np.ix_(rows, columns)] @ (vectors * root)
            _, strength, directions = np.linalg.svd(drift, full_matrices=False)
            lost = 1.0 - np.cumsum(strength**2) / max(float((strength**2).sum()), 1e-300)
            keep = min(int(np.argmax(lost <= LOST)) + 1, MOST)
            chosen = directions[:keep]
            blocks.append(columns)
            to_scores.append((vectors * root) @ chosen.T)
            back = np.zeros((keep, len(gram)))
            back[:, columns] = (chosen / root) @ vectors.T
            to_grid.append(back)
        return cls(blocks, to_scores, np.concatenate(to_grid))

    @property
    def count(self) -> int:
        """Scores."""
        return len(self.to_grid)

    def scores(self, values: Array) -> Array:
        """Return the scores (N, R) of terms on the grid (N, G); NaN where a term of the block is not known."""
        return np.concatenate(
            [values[:, columns] @ weights for columns, weights in zip(self.blocks, self.to_scores, strict=True)], axis=1
        )

    def grid(self, scores: Array) -> Array:
        """Return the terms on the grid (N, G) [µm, µrad] of scores (N, R)."""
        found: Array = scores @ self.to_grid
        return found
