"""From error terms to the tool tip: the measure by which everything is judged.

The working volume is sampled on a grid, so a motion term moves the tip only by its values at the few grid points of
its axis, and a location term by one number. What was measured at a time gives these values, linear between the
positions measured then and constant beyond them; so every time has its own positions, and all have one measure. The
tip's deviation is linear in the values, so its mean square over the volume is a quadratic form r' Q r of their
residuals r. Q is made once per data set.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.chain import Chain
from model.terms import UM
from model.transforms import Array
from training.coverage import Coverage, by_pattern, coverage
from training.dataset import DataSet, interpolation

POINTS_PER_AXIS = 4
"""The working volume is sampled on this grid, corners included: 64 points for three axes."""


@dataclass(frozen=True)
class TipMetric:
    """Maps residuals of measured terms to the tip.

    Attributes
    ----------
    positions : sampled points of the working volume, shape (P, A) [mm]
    grid : per term, its axis' sampled coordinates, shape (g,) [mm]; one for a location term
    coverage : what the measurements show of each term
    matrix : shape (P, 3, G), tip deviation [µm] of each term at each point of its grid [µm, µrad]
    gram : Q, shape (G, G): r' Q r is the mean square over the volume [µm²]
    """

    positions: Array
    grid: dict[str, Array]
    coverage: Coverage
    matrix: Array
    gram: Array

    def slices(self) -> dict[str, slice]:
        """Return where each term's grid stands among the G values."""
        ends = np.cumsum([len(at) for at in self.grid.values()])
        return {
            name: slice(int(end) - len(at), int(end)) for end, (name, at) in zip(ends, self.grid.items(), strict=True)
        }

    def sample(self, values: Array) -> Array:
        """Return the terms on their grids, shape (n, G), from measured columns (n, J), NaN where not measured.

        Linear between the positions that a row knows and constant beyond; NaN for terms that it does not show.
        """
        sampled = np.full((len(values), len(self.gram)), np.nan)
        for name, where in self.slices().items():
            reach = self.coverage[name]
            known = np.isfinite(values[:, reach.columns])
            shown = np.flatnonzero(reach.shown(known))
            for pattern, rows in by_pattern(known[shown]):
                share = _shares(reach.positions[pattern], self.grid[name])
                measured = values[np.ix_(shown[rows], reach.columns[pattern])]
                sampled[shown[rows], where] = measured @ share.T
        return sampled

    def from_columns(self, basis: Array) -> Array:
        """Return the grid's values (G, p) of what all columns together say, such as the basis of fields (J, p)."""
        return self.sample(basis.T).T

    def deviation(self, sampled: Array) -> Array:
        """Return the tip's deviation [µm], shape (n, P, 3), of terms on their grids (n, G); NaN counts as zero."""
        found: Array = np.einsum("pdj,nj->npd", self.matrix, np.nan_to_num(sampled))
        return found

    def mean_square(self, sampled: Array) -> Array:
        """Return the mean square over the volume [µm²], shape (n,), of residuals on the grids (n, G).

        NaN counts as zero: it is the tip's deviation by the terms that are shown.
        """
        known = np.nan_to_num(sampled)
        square: Array = np.maximum(((known @ self.gram) * known).sum(axis=1), 0.0)
        return square

    def whole(self, sampled: Array) -> NDArray[np.bool_]:
        """Return which rows (n,) show all terms."""
        return np.asarray(np.isfinite(sampled).all(axis=1))


def tip_metric(dataset: DataSet) -> TipMetric:
    """Return the metric of a data set's machine and measured columns.

    Raises
    ------
    DataError
        where a term has measurements, but is never shown.
    """
    machine = dataset.machine
    grids = [np.linspace(machine.axes[a].low, machine.axes[a].high, POINTS_PER_AXIS) for a in machine.axis_names]
    positions = np.stack([g.ravel() for g in np.meshgrid(*grids, indexing="ij")], axis=1)
    sensitivity = Chain(machine).sensitivity(positions)[:, :3, :]
    covered = coverage(dataset)
    grid: dict[str, Array] = {}
    parts: list[Array] = []
    for name in covered:
        term = machine.term(name)
        effect = sensitivity[:, :, machine.term_index[name]] * term.to_internal / UM  # µm per µm or µrad
        column = 0 if term.kind == "location" else machine.axis_names.index(term.axis)
        grid[name] = np.zeros(1) if term.kind == "location" else grids[column]
        at = np.zeros(1) if term.kind == "location" else positions[:, column]
        parts.append(effect[:, :, None] * np.equal(at[:, None], grid[name])[:, None, :])
    matrix = np.concatenate(parts, axis=2)
    flat = matrix.reshape(-1, matrix.shape[2])
    return TipMetric(positions, grid, covered, matrix, flat.T @ flat / len(positions))


def _shares(knots: Array, at: Array) -> Array:
    """Return how much each measured position of one term counts at the points `at`, shape (g, m)."""
    share = np.zeros((len(at), len(knots)))
    left, weight = interpolation(knots, at)
    rows = np.arange(len(at))
    share[rows, left] += 1.0 - weight
    share[rows, np.minimum(left + 1, len(knots) - 1)] += weight
    return share
