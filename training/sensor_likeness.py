"""What temperatures alone say: which sensors are alike, and which the others can tell."""

from __future__ import annotations

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from model.sensors import NOISE_DEGC
from model.transforms import Array

ALIKE = 0.95
"""Correlation within runs from which sensors are called interchangeable (chosen: one tells nine tenths of the other's
variance)."""

Chosen = frozenset[int]
"""Sensors, by their numbers in the data set's order."""


def alike(readings: list[Array]) -> list[tuple[Chosen, float]]:
    """Return groups of sensors of which any two correlate by `ALIKE` within runs, and their lowest correlation.

    Parameters
    ----------
    readings : of each run, shape (T, S), without gaps
    """
    within = np.concatenate([r - r.mean(axis=0) for r in readings])
    spread = within.std(axis=0)
    moving = np.flatnonzero(spread > 1e-9)
    if len(moving) < 2:
        return []
    correlation = np.corrcoef(within[:, moving], rowvar=False)
    distance = squareform(np.clip(1.0 - correlation, 0.0, None), checks=False)
    label = fcluster(linkage(distance, "complete"), 1.0 - ALIKE, "distance")
    groups: list[tuple[Chosen, float]] = []
    for which in dict.fromkeys(label.tolist()):
        mine = np.flatnonzero(label == which)
        if len(mine) > 1:
            groups.append((frozenset(moving[mine].tolist()), float(correlation[np.ix_(mine, mine)].min())))
    return groups


def told_best(readings: list[Array]) -> list[tuple[int, Chosen]]:
    """Return the sensors in the order in which the others tell them best, each with those that stay.

    Parameters
    ----------
    readings : of each run, shape (T, S), without gaps
    """
    within = np.concatenate([r - r.mean(axis=0) for r in readings])
    covariance = within.T @ within / len(within) + NOISE_DEGC**2 * np.eye(within.shape[1])
    left = list(range(within.shape[1]))
    steps: list[tuple[int, Chosen]] = []
    while left:
        # The variance of a sensor that the others do not tell (`SensorModel.fill`) is one over its precision.
        precision = np.diag(np.linalg.inv(covariance[np.ix_(left, left)]))
        out = left.pop(int(np.argmax(precision)))
        steps.append((out, frozenset(left)))
    return steps
