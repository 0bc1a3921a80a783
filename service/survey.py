"""How large a correction is over the working volume, from a few positions that stand for it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from model.chain import Chain
from model.error_map import ErrorMap
from model.terms import UM
from model.transforms import Array


@dataclass(frozen=True)
class Survey:
    """Positions, and what each error term does to the correction there.

    Attributes
    ----------
    positions : shape (n, A), the corners of the working volume and its middle [mm]
    effect : shape (n, A, K), -J^-1 G: the correction is, to first order, this times the error terms
    """

    positions: Array
    effect: Array

    @classmethod
    def of(cls, chain: Chain) -> Survey:
        """Return the survey of a machine of linear axes, with its own tool."""
        axes = [chain.machine.axes[a] for a in chain.machine.axis_names]
        middle = [(axis.low + axis.high) / 2.0 for axis in axes]
        positions = np.array([*itertools.product(*((axis.low, axis.high) for axis in axes)), middle])
        sensitivity = chain.sensitivity(positions)[:, :3, :]
        effect = -np.linalg.solve(chain.jacobian(positions)[:, :3], sensitivity)
        return cls(positions, np.asarray(effect, dtype=float))

    def largest_um(self, errors: ErrorMap) -> float:
        """Return the largest correction on any axis at any of the positions [µm]."""
        correction = np.einsum("nak,nk->na", self.effect, errors.evaluate(self.positions))
        return float(np.abs(correction).max() / UM)
