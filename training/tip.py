"""The measure by which everything is judged: the tool tip, from error terms or as it was measured.

The working volume is sampled on a grid, so a motion term moves the tip only by its values at the few grid points of
its axis, and a location term by one number. What was measured at a time gives these values, linear between the
positions measured then and constant beyond them; so every time has its own positions, and all have one measure. The
tip's deviation is linear in the values, so its mean square over the volume is a quadratic form r' Q r of their
residuals r. Q is made once per data set.

Where the tip itself was measured, its residuals at the measured positions count, unless all terms that move it are
known at that time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from model.chain import Chain
from model.terms import UM
from model.transforms import Array
from training.coverage import Coverage, by_pattern, coverage
from training.dataset import DataSet, interpolation
from training.volume import axis_grids, moving_terms, volume_grid


@dataclass(frozen=True)
class TipMetric:
    """Maps residuals of what was measured to the tip.

    What it maps is a row of G values of terms on their grids, and behind them 3m deviations of the tip [µm] at the m
    places of a time.

    Attributes
    ----------
    positions : sampled points of the working volume, shape (P, A) [mm]
    grid : per term, its axis' sampled coordinates, shape (g,) [mm]; one for a location term
    coverage : what the measurements show of each term
    matrix : shape (P, 3, G), tip deviation [µm] of each term at each point of its grid [µm, µrad]
    gram : Q, shape (G + 3m, G + 3m): r' Q r is the mean square over the volume of the terms' part, plus that over the
        places of the other [µm²]
    places : m, at how many positions one time can have the tip's deviation
    complete : whether all terms that move the tip were measured, so that a time that shows them needs no tip
    """

    positions: Array
    grid: dict[str, Array]
    coverage: Coverage
    matrix: Array
    gram: Array
    places: int = 0
    complete: bool = True

    def slices(self) -> dict[str, slice]:
        """Return where each term's grid stands among the G values."""
        ends = np.cumsum([len(at) for at in self.grid.values()])
        return {
            name: slice(int(end) - len(at), int(end)) for end, (name, at) in zip(ends, self.grid.items(), strict=True)
        }

    def sample(self, values: Array) -> Array:
        """Return terms on their grids and the tip, shape (n, G + 3m), from what was measured, (n, J + 3m).

        Terms are linear between the positions that a row knows and constant beyond; NaN where not shown or measured.
        """
        sampled = np.full((len(values), len(self.gram)), np.nan)
        if self.places:
            sampled[:, -3 * self.places :] = values[:, -3 * self.places :]
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
        """Return the grid's values (G + 3m, p) of what all columns together say, such as the basis of fields (J, p)."""
        gap = np.zeros((basis.shape[1], 3 * self.places))
        return self.sample(np.concatenate([basis.T, gap], axis=1)).T

    def deviation(self, sampled: Array) -> Array:
        """Return the tip's deviation [µm] over the volume, shape (n, P, 3), of what `mean_square` judges.

        By the terms that are shown (others count as zero); where the places were measured, their mean at all points.
        """
        size = self.matrix.shape[2]
        found: Array = np.einsum("pdj,nj->npd", self.matrix, np.nan_to_num(sampled[:, :size]))
        if not self.places:
            return found
        tip = sampled[:, size:].reshape(len(sampled), self.places, 3)
        mean = np.nan_to_num(tip).sum(axis=1) / np.maximum(np.isfinite(tip).sum(axis=1), 1)
        return np.where(self._at_places(sampled)[:, None, None], mean[:, None, :], found)

    def mean_square(self, sampled: Array) -> Array:
        """Return the tip's mean square [µm²], shape (n,), of residuals (n, G + 3m), NaN where not measured.

        Over the volume by the terms that are shown (others count as zero), or over the places that were measured.
        """
        known = np.nan_to_num(sampled)
        size = self.matrix.shape[2]
        terms = known[:, :size]
        square: Array = np.maximum(((terms @ self.gram[:size, :size]) * terms).sum(axis=1), 0.0)
        if not self.places:
            return square
        count = np.isfinite(sampled[:, size:]).sum(axis=1) / 3.0
        at_places = (known[:, size:] ** 2).sum(axis=1) / np.maximum(count, 1.0 / 3.0)
        return np.where(self._at_places(sampled), at_places, square)

    def whole(self, sampled: Array) -> NDArray[np.bool_]:
        """Return which rows (n,) show all that moves the tip: all terms, or the tip itself."""
        if not self.places:
            return np.asarray(np.isfinite(sampled).all(axis=1))
        return self._at_places(sampled) | self._settled(sampled)

    def _at_places(self, sampled: Array) -> NDArray[np.bool_]:
        """Return which rows are judged at the measured places."""
        touched = np.isfinite(sampled[:, self.matrix.shape[2] :]).any(axis=1)
        return np.asarray(touched & ~self._settled(sampled))

    def _settled(self, sampled: Array) -> NDArray[np.bool_]:
        """Return which rows know all terms that move the tip."""
        if not self.complete:
            return np.zeros(len(sampled), dtype=bool)
        return np.asarray(np.isfinite(sampled[:, : self.matrix.shape[2]]).all(axis=1))


def tip_metric(dataset: DataSet) -> TipMetric:
    """Return the metric of a data set's machine and measured columns.

    Raises
    ------
    DataError
        where a term has measurements, but is never shown.
    """
    machine = dataset.machine
    grids, positions = axis_grids(machine), volume_grid(machine)
    sensitivity = Chain(machine).sensitivity(positions)[:, :3, :]
    covered = coverage(dataset)
    grid: dict[str, Array] = {}
    parts: list[Array] = [np.zeros((len(positions), 3, 0))]
    for name in covered:
        term = machine.term(name)
        effect = sensitivity[:, :, machine.term_index[name]] * term.to_internal / UM  # µm per µm or µrad
        column = 0 if term.kind == "location" else machine.axis_names.index(term.axis)
        grid[name] = np.zeros(1) if term.kind == "location" else grids[column]
        at = np.zeros(1) if term.kind == "location" else positions[:, column]
        parts.append(effect[:, :, None] * np.equal(at[:, None], grid[name])[:, None, :])
    matrix = np.concatenate(parts, axis=2)
    flat = matrix.reshape(3 * len(positions), matrix.shape[2])
    places = dataset.places
    gram = block_diag(flat.T @ flat / len(positions), np.eye(3 * places) / max(places, 1))
    complete = set(moving_terms(machine)) <= set(covered)
    return TipMetric(positions, grid, covered, matrix, gram, places, complete)


def _shares(knots: Array, at: Array) -> Array:
    """Return how much each measured position of one term counts at the points `at`, shape (g, m)."""
    share = np.zeros((len(at), len(knots)))
    left, weight = interpolation(knots, at)
    rows = np.arange(len(at))
    share[rows, left] += 1.0 - weight
    share[rows, np.minimum(left + 1, len(knots) - 1)] += weight
    return share
