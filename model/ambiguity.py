"""Which coefficients a measurement cannot tell apart.

Every coefficient has an effect on what was measured. Some have none; some have the same, up to a factor; and of some
others the effects add up to nothing, so that only combinations of them can be known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from model.transforms import Array

UNSEEN = 1e-6
"""Length of an effect, of at most 1, that counts as none."""
ALIKE = 1e-5
"""Distance of two effects of length 1 that counts as none."""
SOUND = 0.05
"""Part of a coefficient left in the null space, above which it may be traded first."""
NEGLIGIBLE = 1e-5
"""Part of a trade's largest factor below which the others count as zero."""
SHUFFLES = 8
"""Orders of elimination tried in search of short trades, beside the two that are given."""

Trade = dict[int, float]
"""A change of coefficients that nothing measured can show: by coefficient, the amount."""


@dataclass(frozen=True)
class Ambiguities:
    """Coefficients that the measurement does not separate.

    Together they say everything: the undetermined combinations number `len(unseen)`, plus one less than its members
    for each of `alike`, plus `len(combined)`.

    Attributes
    ----------
    unseen : coefficients without any effect
    alike : groups of coefficients with the same effect up to a factor: by coefficient, its effect in terms of the first
    combined : trades between groups, each named by one member
    """

    unseen: tuple[int, ...]
    alike: tuple[dict[int, float], ...]
    combined: tuple[Trade, ...]

    @property
    def count(self) -> int:
        """How many combinations are undetermined."""
        return len(self.unseen) + sum(len(group) - 1 for group in self.alike) + len(self.combined)


def find_ambiguities(visible: Array, order: Sequence[int]) -> Ambiguities:
    """Return what cannot be told apart.

    Parameters
    ----------
    visible : orthonormal basis of what the measurement determines, shape (p, r). Its rows are the coefficients'
        effects in coordinates in which no direction is seen better than another
    order : coefficients in the order in which they are traded for others, the least important first
    """
    length = np.linalg.norm(visible, axis=1)
    unseen = tuple(int(k) for k in np.flatnonzero(length < UNSEEN))
    groups: list[dict[int, float]] = []
    for k in reversed(order):
        if k in unseen:
            continue
        for group in groups:
            first = next(iter(group))
            sign = 1.0 if visible[k] @ visible[first] > 0 else -1.0
            if np.linalg.norm(sign * visible[k] / length[k] - visible[first] / length[first]) < ALIKE:
                group[k] = float(sign * length[k] / length[first])
                break
        else:
            groups.append({k: 1.0})
    named = [next(iter(group)) for group in groups]  # each group's most important member
    if not named:
        return Ambiguities(unseen, (), ())
    _, _, vt = np.linalg.svd(visible[named].T, full_matrices=True)
    trades = _short_trades(vt[visible.shape[1] :])
    combined = tuple({named[k]: value for k, value in trade.items()} for trade in trades)
    return Ambiguities(unseen, tuple(g for g in groups if len(g) > 1), combined)


def _short_trades(null: Array) -> list[Trade]:
    """Return a basis of the space that the rows of `null` (d, p) span, of vectors with few entries.

    Elimination in some order gives vectors of which no entry can be left out; from those of several orders the
    shortest that are independent are taken.
    """
    count, width = null.shape
    rng = np.random.default_rng(0)  # the same measurement gives the same sentences
    orders = [list(range(width)), list(range(width))[::-1], *(list(rng.permutation(width)) for _ in range(SHUFFLES))]
    found = [_readable(row) for order in orders if count for row in _reduced(null, order)]
    found.sort(key=lambda trade: (len(trade), sorted(trade)))
    kept: list[Trade] = []
    basis = np.zeros((0, width))
    for trade in found:
        vector = np.zeros(width)
        vector[list(trade)] = list(trade.values())
        vector /= np.linalg.norm(vector)
        fresh = vector - basis.T @ (basis @ vector)
        if len(kept) < count and np.linalg.norm(fresh) > SOUND * SOUND:
            kept.append(trade)
            basis = np.linalg.qr(np.vstack([basis, vector]).T)[0].T
    return kept


def _reduced(rows: Array, order: Sequence[int]) -> Array:
    """Return a basis of the same space, shape (d, p), in which each row is 1 at its own pivot, others are 0 there."""
    left = rows.copy()
    pivots: list[int] = []
    while len(left):
        sizes = np.linalg.norm(left, axis=0)
        sizes[pivots] = 0.0
        pivot = next((k for k in order if sizes[k] > SOUND), int(np.argmax(sizes)))
        pivots.append(pivot)
        # A rotation of the rows that leaves the pivot in the first one only keeps them orthonormal.
        turned, _ = np.linalg.qr(left[:, [pivot]], mode="complete")
        left = (turned.T @ left)[1:]
    return np.asarray(np.linalg.solve(rows[:, pivots], rows), dtype=float)


def _readable(row: Array) -> Trade:
    largest = np.abs(row).max()
    return {int(k): float(row[k]) for k in np.flatnonzero(np.abs(row) > NEGLIGIBLE * largest)}
