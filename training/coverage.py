"""When a measurement shows a term: at enough positions at one time, far enough apart."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.exceptions import DataError
from model.transforms import Array
from training.dataset import Column, DataSet

ENOUGH = 4
"""Positions at one time that settle a cubic, the series that is trained (`trainer.Settings.degree`)."""
SPAN = 0.5
"""Share of the span ever measured that the positions of one time must cover (chosen)."""


@dataclass(frozen=True)
class Reach:
    """Where a term was ever measured, and what one time must show of it.

    Attributes
    ----------
    columns : measured columns of the term, shape (m,), by position
    positions : of these, shape (m,) [mm]; 0 for a location term
    most : positions measured at one time, at most
    """

    columns: NDArray[np.intp]
    positions: Array
    most: int

    @property
    def needed(self) -> int:
        """Positions that one time must have."""
        return min(ENOUGH, self.most)

    @property
    def span(self) -> float:
        """Distance that they must span [mm]."""
        return SPAN * float(self.positions[-1] - self.positions[0])

    def shown(self, known: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which rows (n,) show the term, from which of its columns each row knows, shape (n, m)."""
        low = np.where(known, self.positions, np.inf).min(axis=1)
        high = np.where(known, self.positions, -np.inf).max(axis=1)
        shown: NDArray[np.bool_] = (known.sum(axis=1) >= self.needed) & (high - low >= self.span * (1.0 - 1e-9))
        return shown


Coverage = dict[str, Reach]
"""By term, in the machine's order."""


def coverage(dataset: DataSet) -> Coverage:
    """Return what each term's measurements cover, over all runs.

    Raises
    ------
    DataError
        where a term has measurements, but no time at which they show it.
    """
    columns = columns_by_term(dataset.columns)
    found: Coverage = {}
    for name in dataset.measured_terms:
        mine = columns[name]
        positions = np.array([dataset.columns[j][1] or 0.0 for j in mine])
        known = [np.isfinite(run.values[:, mine]) for run in dataset.runs.values()]
        found[name] = Reach(mine, positions, max(int(k.sum(axis=1).max()) for k in known))
        if not any(found[name].shown(k).any() for k in known):
            raise DataError(
                f"data set '{dataset.path}' must show {name} at some time at {max(found[name].needed, 2)} or more "
                f"positions that span {found[name].span:g} mm, half of all that were measured, got at most "
                f"{found[name].most} at one time; give measurements of one sweep the same time_s"
            )
    return found


def columns_by_term(columns: Iterable[Column]) -> dict[str, NDArray[np.intp]]:
    """Return the columns of each term."""
    found: dict[str, list[int]] = {}
    for j, (term, _) in enumerate(columns):
        found.setdefault(term, []).append(j)
    return {term: np.array(mine, dtype=np.intp) for term, mine in found.items()}


def by_pattern(known: NDArray[np.bool_]) -> list[tuple[NDArray[np.bool_], NDArray[np.intp]]]:
    """Return the distinct rows of a mask (n, m), and the numbers of the rows that are like each."""
    if not len(known):
        return []
    if (known == known[0]).all():  # as mostly; finding that out by sorting takes long
        return [(known[0], np.arange(len(known)))]
    patterns, which = np.unique(known, axis=0, return_inverse=True)
    order = np.argsort(which.ravel(), kind="stable")
    ends = np.cumsum(np.bincount(which.ravel(), minlength=len(patterns)))
    return list(zip(patterns, np.split(order, ends[:-1]), strict=True))
