"""Tool-tip deviations at positions, as a touch probe, an R-test or a laser tracker gives them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from model.chain import Chain
from model.error_map import ErrorMap
from model.exceptions import DataError
from model.machine import Machine
from model.measurements import DISPLACEMENTS
from model.positions import check_positions
from model.tables import read_table
from model.terms import UM
from model.transforms import Array

MOST_PLACES = 64
"""So many positions or fewer in a whole data set are places that are measured again and again; each has its own columns
then. More are positions drawn anew each time (chosen)."""


@dataclass(frozen=True)
class Touches:
    """Measurements of one run, in the order of time.

    Attributes
    ----------
    time_s : shape (n,) [s]
    q : shape (n, A) [mm, degree]
    deviation_um : shape (n, 3), actual minus nominal in the workpiece frame, NaN where not measured
    """

    time_s: Array
    q: Array
    deviation_um: Array


def read_touches(path: Path, machine: Machine, largest_um: float) -> dict[str, Touches]:
    """Read a table of tool-tip deviations.

    Raises
    ------
    DataError
        where a column is missing, a value is not one, a position is out of range, or a measurement stands twice.
    """
    table = read_table(path, ("run", "time_s", *machine.axis_names, *DISPLACEMENTS))
    if not len(table):
        raise DataError(f"'{path}' must have at least one row, got none")
    q = check_positions(np.stack([table.numbers[a] for a in machine.axis_names], axis=1), machine, str(path))
    time_s = table.numbers["time_s"]
    deviation = np.stack([table.numbers[name] for name in DISPLACEMENTS], axis=1)
    if not np.isfinite(time_s).all():
        row = int(np.argmin(np.isfinite(time_s)))
        raise DataError(f"'{path}': time_s must be a finite number, got {time_s[row]} in row {row + 1}")
    wrong = ~np.isnan(deviation) & ~(np.abs(deviation) <= largest_um)
    if wrong.any():
        row, column = (int(i) for i in np.argwhere(wrong)[0])
        raise DataError(
            f"'{path}': {DISPLACEMENTS[column]} must lie within ±{largest_um:g} µm, got {deviation[row, column]:g} in "
            f"row {row + 1}"
        )
    kept = ~np.isnan(deviation).all(axis=1)
    if not kept.any():
        raise DataError(f"'{path}' must have a measured value in one of {', '.join(DISPLACEMENTS)}, got none")
    runs: dict[str, Touches] = {}
    for name in dict.fromkeys(table.text["run"][kept].tolist()):
        rows = np.flatnonzero((table.text["run"] == name) & kept)
        rows = rows[np.argsort(time_s[rows], kind="stable")]
        _, first = np.unique(np.column_stack([time_s[rows], q[rows]]), axis=0, return_index=True)
        if len(first) < len(rows):
            again = int(rows[np.setdiff1d(np.arange(len(rows)), first)[0]])
            raise DataError(
                f"'{path}': the position in row {again + 1} stands twice at time {time_s[again]:g} in run '{name}'; "
                "keep one"
            )
        runs[name] = Touches(time_s[rows], q[rows], deviation[rows])
    return runs


def no_touches(machine: Machine) -> Touches:
    """Return the measurements of a run without any."""
    return Touches(np.zeros(0), np.zeros((0, len(machine.axis_names))), np.zeros((0, 3)))


def without_cold(touches: Touches, machine: Machine, cold: ErrorMap) -> Touches:
    """Return what is left of the deviations when the cold machine's are taken out: the thermal part."""
    expected = Chain(machine).deviation(touches.q, cold.evaluate(touches.q)).position_mm / UM
    return Touches(touches.time_s, touches.q, touches.deviation_um - expected)


@dataclass(frozen=True)
class Places:
    """Where each measurement stands among those of its time.

    Attributes
    ----------
    count : m, how many measurements one time can have
    known : positions that have a place of their own, shape (m, A), or None where they are drawn anew each time
    """

    count: int
    known: Array | None

    @classmethod
    def of(cls, runs: Iterable[Touches]) -> Places:
        """Return the places of all runs."""
        every = list(runs)
        if not every:
            return cls(0, None)
        known = np.unique(np.concatenate([t.q for t in every]), axis=0)
        if len(known) <= MOST_PLACES:
            return cls(len(known), known)
        return cls(max(int(np.unique(t.time_s, return_counts=True)[1].max()) for t in every), None)

    def arrange(self, touches: Touches, time_s: Array) -> tuple[Array, Array]:
        """Return positions (N, m, A) and deviations (N, m, 3) at the times (N,), NaN where there is no measurement."""
        row = np.searchsorted(time_s, touches.time_s)
        if self.known is None:  # one after the other
            first = np.searchsorted(touches.time_s, touches.time_s)
            place = np.arange(len(row)) - first
        else:
            both, place = np.unique(np.concatenate([self.known, touches.q]), axis=0, return_inverse=True)
            assert len(both) == self.count
            place = place.ravel()[self.count :]
        q = np.full((len(time_s), self.count, touches.q.shape[1]), np.nan)
        deviation = np.full((len(time_s), self.count, 3), np.nan)
        q[row, place], deviation[row, place] = touches.q, touches.deviation_um
        return q, deviation
