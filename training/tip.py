"""From error terms to the tool tip: the measure by which everything is judged.

The tip's deviation over the working volume is linear in the measured terms, so its mean square is a quadratic form
r' Q r of their residuals r. Q is made once per data set.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.chain import Chain
from model.terms import UM
from model.transforms import Array
from training.dataset import Column, DataSet, interpolation

POINTS_PER_AXIS = 4
"""The working volume is sampled on this grid, corners included: 64 points for three axes."""


@dataclass(frozen=True)
class TipMetric:
    """Maps residuals of measured terms to the tip.

    Attributes
    ----------
    positions : sampled points of the working volume, shape (P, A) [mm]
    matrix : shape (P, 3, J), tip deviation [µm] of each measured column [µm, µrad]
    gram : Q, shape (J, J): r' Q r is the mean square over the volume [µm²]
    """

    positions: Array
    matrix: Array
    gram: Array

    def deviation(self, values: Array) -> Array:
        """Return the tip's deviation [µm], shape (n, P, 3), for measured columns of shape (n, J)."""
        found: Array = np.einsum("pdj,nj->npd", self.matrix, np.nan_to_num(values))
        return found

    def mean_square(self, residual: Array) -> Array:
        """Return the mean square over the volume [µm²], shape (n,), of residuals (n, J); NaN counts as zero."""
        known = np.nan_to_num(residual)
        square: Array = np.maximum(((known @ self.gram) * known).sum(axis=1), 0.0)
        return square


def tip_metric(dataset: DataSet) -> TipMetric:
    """Return the metric of a data set's machine and measured columns.

    Terms are linear between their measured positions and constant beyond them.
    """
    machine = dataset.machine
    grids = [np.linspace(machine.axes[a].low, machine.axes[a].high, POINTS_PER_AXIS) for a in machine.axis_names]
    positions = np.stack([g.ravel() for g in np.meshgrid(*grids, indexing="ij")], axis=1)
    sensitivity = Chain(machine).sensitivity(positions)[:, :3, :]
    matrix = np.zeros((len(positions), 3, len(dataset.columns)))
    for name in dataset.terms:
        term = machine.term(name)
        columns = [j for j, (written, _) in enumerate(dataset.columns) if written == name]
        effect = sensitivity[:, :, machine.term_index[name]] * term.to_internal / UM  # µm per µm or µrad
        column = 0 if term.kind == "location" else machine.axis_names.index(term.axis)
        share = _shares([dataset.columns[j] for j in columns], positions[:, column])
        matrix[:, :, columns] = effect[:, :, None] * share[:, None, :]
    flat = matrix.reshape(-1, len(dataset.columns))
    return TipMetric(positions, matrix, flat.T @ flat / len(positions))


def _shares(columns: list[Column], at: Array) -> Array:
    """Return how much each measured position of one term counts at the points `at`, shape (P, m)."""
    knots = np.array([0.0 if position is None else position for _, position in columns])
    share = np.zeros((len(at), len(knots)))
    left, weight = interpolation(knots, at)
    rows = np.arange(len(at))
    share[rows, left] += 1.0 - weight
    share[rows, np.minimum(left + 1, len(knots) - 1)] += weight
    return share
