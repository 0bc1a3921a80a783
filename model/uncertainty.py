"""How far a prediction may be off: standard deviations of coefficients, error terms and the tool tip.

What the network leaves has the same directions at all times and a size that depends on the thermal state: small where
training saw such states, large where it did not. So the covariance of the coefficients is s²(t) Σ d d', with a few
directions d, and s² = floor + rise · h(t). The leverage h is that of ridge regression, z' (Z'Z/n + ridge)⁻¹ z, of the
scaled modes z. Made by `training/uncertainty.py`.
"""

from __future__ import annotations

import numpy as np

from model.chain import Chain
from model.exceptions import BundleError
from model.fields import Fields
from model.manifest import UncertaintyRecord
from model.terms import UM
from model.transforms import Array

NORMAL_95 = 1.959964
"""Half width of the interval that holds 95 % of a normal distribution, in standard deviations."""
CHUNK = 4096
"""Positions whose sensitivities are held in memory at a time."""


class Uncertainty:
    """Standard deviations of a network's predictions; 1.96 times them is the 95 % interval.

    They are of the thermal part alone: measured geometric errors have an uncertainty of their own.

    Attributes
    ----------
    misfit_um : standard deviation of the tip that no coefficient explains
    largest_size : of the thermal states that training left out in turn, None where the bundle does not say

    Parameters
    ----------
    fields : of the network's P coefficients
    record : of the manifest
    modes : M, size of the thermal state

    Raises
    ------
    BundleError
        where the record does not fit fields and modes.
    """

    def __init__(self, fields: Fields, record: UncertaintyRecord, modes: int) -> None:
        self.fields = fields
        self._directions = np.array(record.directions) * record.scale  # (R, P)
        self._size = np.array(record.mode_size)
        self._seen = np.array(record.seen_directions).reshape(-1, modes)  # (L, M)
        self.misfit_um, self.largest_size = record.misfit_um, record.largest_size
        self._floor, self._rise = record.floor, record.rise
        if self._directions.ndim != 2 or self._directions.shape[1] != fields.size or self._size.shape != (modes,):
            raise BundleError(
                f"uncertainty in the manifest must be of {fields.size} coefficients and {modes} modes, got "
                f"{self._directions.shape[-1]} and {self._size.size}; export the bundle again"
            )

    def size(self, modes: Array, start: Array | None = None) -> Array:
        """Return s of thermal states (..., M), shape (...); 1 for a typical state of what training left out.

        Parameters
        ----------
        start : modes at the start of the run (M,), where the network knows only changes since then
        """
        return self.size_of(self._size * (modes if start is None else modes - start))

    def size_of(self, scaled: Array) -> Array:
        """Return s of scaled modes (..., M), shape (...)."""
        beyond = (scaled**2).sum(axis=-1) - ((scaled @ self._seen.T) ** 2).sum(axis=-1)
        found: Array = np.sqrt(self._floor + self._rise * np.maximum(beyond, 0.0))
        return found

    @property
    def directions(self) -> Array:
        """Directions d of the coefficients' covariance [µm, µrad], shape (R, P)."""
        return self._directions

    def coefficients(self, size: Array) -> Array:
        """Return the standard deviation of each coefficient [µm, µrad], shape (n, P), for s of shape (n,)."""
        return size[:, None] * _root_sum(self._directions, axis=0)

    def terms(self, q: Array, size: Array) -> Array:
        """Return the standard deviation of each error term [mm, rad], shape (n, K), at q (n, A) for s (n,)."""
        return size[:, None] * _root_sum(self._moved(q), axis=0)

    def tip(self, q: Array, size: Array) -> Array:
        """Return the standard deviation of the tip in x, y and z [µm], shape (n, 3), at q (n, A) for s (n,)."""
        return self.whole(self.usual_tip(q), size)

    def whole(self, usual: Array, size: Array) -> Array:
        """Return the tip's standard deviation [µm] (n, m) from the coefficients' part for s = 1 (n, m), for s (n,)."""
        return np.hypot(size[:, None] * usual, self.misfit_um)

    def usual_tip(self, q: Array, tool_mm: Array | None = None) -> Array:
        """Return the coefficients' part of the tip's standard deviation [µm], shape (n, 3), at q (n, A) for s = 1.

        `tool_mm` is the tip in the tool frame, shape (3,), by default the machine's.
        """
        chain = Chain(self.fields.machine)
        found = np.zeros((len(q), 3))
        for first in range(0, len(q), CHUNK):
            part = q[first : first + CHUNK]
            moved = np.einsum("nik,rnk->rni", chain.sensitivity(part, tool_mm)[:, :3], self._moved(part))
            found[first : first + CHUNK] = _root_sum(moved, axis=0) / UM
        return found

    def _moved(self, q: Array) -> Array:
        """Return the error terms of each direction, shape (R, n, K) [mm, rad]."""
        return self.fields.evaluate_each(self._directions, q)


def _root_sum(values: Array, axis: int) -> Array:
    found: Array = np.sqrt((values**2).sum(axis=axis))
    return found
