"""The first reading of a sensor, which has no earlier one to be compared with: compared with the other sensors.

A wrong first reading is worse than a later one: the thermal modes start in equilibrium with it, and the slow ones
remember it for hours.
"""

from __future__ import annotations

import numpy as np

from model.sensors import NOISE_DEGC, SensorModel
from model.transforms import Array

DOUBTFUL_SD = 6.0
"""Standard deviations from what the other sensors suggest, from which a first reading is not believed (chosen)."""
DOUBTFUL_K = 5.0
"""And the least distance [K]: a new season may make any of these sensors a little unlike its training (chosen)."""


def doubtful(sensor_model: SensorModel, readings: Array, unknown: Array) -> dict[int, float]:
    """Return which first readings to doubt, and what the other sensors suggest instead [°C].

    The most surprising one goes first, and the rest are judged anew without it, since one wrong sensor makes its
    neighbours look wrong, too.

    Parameters
    ----------
    readings : shape (S,) [°C], NaN where there is no plausible reading
    unknown : shape (S,), whether a sensor has had no reading before
    """
    found: dict[int, float] = {}
    left = np.array(readings, dtype=float)
    while True:
        worst, surprise, suggested = -1, 1.0, 0.0
        for i in np.flatnonzero(unknown & np.isfinite(left)):
            without = left.copy()
            without[i] = np.nan
            if not np.isfinite(without).any():
                continue
            estimate = float(sensor_model.fill(without)[i])
            limit = max(DOUBTFUL_K, DOUBTFUL_SD * _spread(sensor_model, np.isfinite(without), int(i)))
            if abs(left[i] - estimate) / limit > surprise:
                worst, surprise, suggested = int(i), abs(left[i] - estimate) / limit, estimate
        if worst < 0:
            return found
        found[worst] = suggested
        left[worst] = np.nan


def _spread(sensor_model: SensorModel, known: Array, index: int) -> float:
    """Return the standard deviation of a sensor given the known others [K]."""
    total = sensor_model.covariance + NOISE_DEGC**2 * np.eye(len(sensor_model.mean))
    others = np.flatnonzero(known)
    explained = total[index, others] @ np.linalg.solve(total[np.ix_(others, others)], total[others, index])
    return float(np.sqrt(max(total[index, index] - explained, 0.0)))
