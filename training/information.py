"""What measurements say about the coefficients of the fields, whether terms or the tip were measured.

A machine has far more coefficients than a tool tip has directions, and several make the same deviation. So they are
written as c = S (U z + ...): S scales each by the size that it is expected to have, and U are the directions that the
tip sees over the working volume, some dozen of some hundred, and those of coefficients that were measured themselves
at a time that does not show all. Each measurement is a row of z: G(q) Φ(q) S U for the tip at q, a row of U for a
coefficient. Rows of one time add up to a precision H'H/ν and a vector H'y/ν, and that is all that the decoder needs
of them (`training/tip_decoder.py`).

Directions that no measurement sees keep their expected value, zero; those that only move together share what was
seen by their sizes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.fields import Fields, turns
from model.tip_effects import tip_effects
from model.transforms import Array
from training.coverage import by_pattern
from training.effects import volume_form

SMOOTH = 0.5
"""Expected size of a coefficient's effect on the tip, beside that of the one a degree lower (chosen)."""
LEVER_M = 0.25
"""Least lever by which an angle is expected to move the tip, µm per µrad: about half a machine's travel (chosen). A
shorter one, such as that of a roll of the spindle, would let it be of any size, and another tool would show it."""
SEEN = 1e-6
"""Share of the largest direction's mean square at the tip below which a direction is not seen (chosen)."""
NOISE = 0.03
"""Variance of a tip measurement's own error beside that of what the decoder leaves: about 1 µm beside 6 µm (chosen)."""
NOISE_TERMS = 1e-3
"""The same for a coefficient that was measured itself: an average over positions (chosen)."""


@dataclass(frozen=True)
class Directions:
    """Directions of the coefficients that measurements see.

    Attributes
    ----------
    size : S, shape (P,), zero for coefficients that do not move the tip
    seen : U, shape (P, r), orthonormal
    """

    size: Array
    seen: Array

    @classmethod
    def of(cls, fields: Fields, measured: NDArray[np.bool_] | None = None) -> Directions:
        """Return the directions that the tip sees, and those of coefficients (P,) that were measured themselves."""
        form = volume_form(fields)
        effect, angular = np.sqrt(np.diag(form)), _angular(fields)
        least = np.where(angular, LEVER_M, 0.0)
        size = np.where(effect > 0.0, SMOOTH ** _degrees(fields) / np.maximum(effect, np.maximum(least, 1e-12)), 0.0)
        values, vectors = np.linalg.eigh(size[:, None] * form * size)
        seen = vectors[:, values > SEEN * values[-1]]
        if measured is not None:
            alone = np.eye(fields.size)[:, measured & (size > 0.0)]
            more, strength, _ = np.linalg.svd(alone - seen @ (seen.T @ alone), full_matrices=False)
            seen = np.concatenate([seen, more[:, strength > 1e-6]], axis=1)
        return cls(size, seen)

    def coefficients(self, weights: Array) -> Array:
        """Return weights of the coefficients (F, P) from those of the directions (F, r)."""
        found: Array = (weights @ self.seen.T) * self.size
        return found

    def unseen(self, weights: Array) -> Array:
        """Return the part of the coefficients' weights (F, P) that the directions do not hold."""
        unit = np.divide(weights, self.size, out=np.zeros_like(weights), where=self.size > 0.0)
        rest: Array = weights - self.coefficients(unit @ self.seen)
        return rest


def _angular(fields: Fields) -> NDArray[np.bool_]:
    """Return which coefficients are angles, shape (P,)."""
    angular = np.zeros(fields.size, dtype=bool)
    for name, where in fields.slices().items():
        angular[where] = fields.machine.term(name).angular
    return angular


def _degrees(fields: Fields) -> Array:
    """Return the degree of each coefficient, shape (P,): of its polynomial, or of its harmonic."""
    degrees: list[float] = []
    for name, where in fields.slices().items():
        term = fields.machine.term(name)
        rotary = term.kind == "motion" and turns(fields.machine.axes[term.axis])
        degrees += [float((d + 1) // 2 if rotary else d) for d in range(where.stop - where.start)]
    return np.array(degrees)


@dataclass(frozen=True)
class Information:
    """What the measurements of each time say about z.

    Attributes
    ----------
    directions : what z stands for
    precision : H'H/ν, shape (N, r, r)
    vector : H'y/ν, shape (N, r)
    """

    directions: Directions
    precision: Array
    vector: Array

    def where(self, rows: NDArray[np.bool_]) -> Information:
        """Return that of the times of a mask."""
        return Information(self.directions, self.precision[rows], self.vector[rows])

    def less(self, coefficients: Array) -> Information:
        """Return what is left to be said when these coefficients (N, P) are taken out."""
        size = self.directions.size
        unit = np.divide(coefficients, size, out=np.zeros_like(coefficients), where=size > 0.0)
        taken = np.einsum("nij,nj->ni", self.precision, unit @ self.directions.seen)
        return Information(self.directions, self.precision, self.vector - taken)


def gather(fields: Fields, targets: Array, q: Array, deviation: Array) -> Information | None:
    """Return what measured coefficients and tip deviations say, or None where the coefficients say it all.

    Parameters
    ----------
    targets : shape (N, P), coefficients of terms that were measured themselves [µm, µrad], NaN where not
    q : shape (N, m, A), measured positions [mm, degree], NaN where the tip was not measured
    deviation : shape (N, m, 3), of the tip there [µm], NaN where not measured
    """
    moving = np.asarray(Directions.of(fields).size > 0.0)
    known = np.isfinite(targets)
    known[:, ~moving] = False
    settled = np.asarray(known[:, moving].all(axis=1))
    directions = Directions.of(fields, np.asarray(known[~settled].any(axis=0)))
    rows, places = np.nonzero(np.isfinite(deviation).any(axis=2) & ~settled[:, None])
    if not len(rows):
        return None
    size = directions.seen.shape[1]
    precision, vector = np.zeros((len(targets), size, size)), np.zeros((len(targets), size))
    effects = _seen_effects(fields, directions, q[rows, places])  # (n, 3, r)
    measured = deviation[rows, places]
    there = np.isfinite(measured)
    effects *= there[:, :, None]
    noise = NOISE * float((effects**2).sum() / there.sum())
    np.add.at(precision, rows, np.einsum("ndi,ndj->nij", effects, effects) / noise)
    np.add.at(vector, rows, np.einsum("ndi,nd->ni", effects, np.nan_to_num(measured)) / noise)
    for pattern, at in by_pattern(known):
        if not pattern.any():
            continue
        seen = directions.seen[pattern]
        # Where all is known, rows hold directions that nobody sees; their part falls out with U'.
        precision[at] += seen.T @ seen / NOISE_TERMS
        vector[at] += (targets[np.ix_(at, np.flatnonzero(pattern))] / directions.size[pattern]) @ seen / NOISE_TERMS
    return Information(directions, precision, vector)


CHUNK = 4096
"""Positions whose effects are held in memory at a time."""


def _seen_effects(fields: Fields, directions: Directions, q: Array) -> Array:
    """Return the tip's deviation [µm] by each direction, shape (n, 3, r)."""
    scaled = directions.size[:, None] * directions.seen
    return np.concatenate([tip_effects(fields, q[i : i + CHUNK]) @ scaled for i in range(0, len(q), CHUNK)])
