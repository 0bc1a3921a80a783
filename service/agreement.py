"""How far each sensor is from what the others suggest: the evidence that the guard judges by.

Under the sensors' joint normal distribution, with precision P of those that are known, the distance of sensor i from
its estimate by all others is (P d)_i / P_ii for d from the mean, with a variance of 1 / P_ii. The same holds for
changes since an earlier moment, without the mean.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.sensors import NOISE_DEGC, SensorModel
from model.transforms import Array

MOST_PATTERNS = 256
"""Sets of known sensors whose precisions are kept; a machine meets a few."""
EXCHANGED_GAIN, EXCHANGED_SHARE = 100.0, 0.25
"""By how much an exchange of two readings must lower the squared Mahalanobis distance of all, and to which share of it
(chosen: a synthetic machine in a hall colder than any in training has 170, and its sensors are not exchanged)."""
FREEDOM = 3.0
"""Degrees of freedom of the sensors' distribution: the fewer, the more a strange day excuses (chosen)."""


class Agreement:
    """A sensor model, made ready to compare each sensor with the others.

    Attributes
    ----------
    sensor_model : joint normal distribution of the sensors
    """

    def __init__(self, sensor_model: SensorModel) -> None:
        self.sensor_model = sensor_model
        self._total = sensor_model.covariance + NOISE_DEGC**2 * np.eye(len(sensor_model.mean))
        self._known: dict[bytes, tuple[Array, Array]] = {}

    def distances(self, readings: Array, strangest: float = math.inf) -> tuple[Array, Array]:
        """Return how far each reading is from what the others suggest [K], and how far is usual [K], both (S,).

        Where the others themselves are unlike training, more is usual: by the conditional distribution of Student's t.
        A reading that is not known, or the only one, has a distance of 0, of which any is usual.

        Parameters
        ----------
        readings : shape (S,) [°C], NaN for those not known
        strangest : how many times more a strange day may make usual, at most
        """
        known = np.isfinite(readings)
        gain, usual = self._made_ready(known)
        difference = np.where(known, readings - self.sensor_model.mean, 0.0)
        distance = gain @ difference
        weighed = distance / usual**2  # the precision times the difference
        others = difference @ weighed - distance * weighed  # squared Mahalanobis distances without each of them
        count = max(int(known.sum()) - 1, 1)
        strange = np.sqrt(np.clip((FREEDOM + others) / (FREEDOM + count), 1.0, strangest**2))
        return distance, usual * strange

    def exchanged(self, readings: Array) -> tuple[int, int] | None:
        """Return the two sensors whose readings make sense only the other way round, None where there are none.

        Each alone may pass, since the other one makes the day look strange.
        """
        known = np.isfinite(readings)
        gain, usual = self._made_ready(known)
        difference = np.where(known, readings - self.sensor_model.mean, 0.0)
        weighed = (gain @ difference) / usual**2
        before = float(difference @ weighed)
        if before < EXCHANGED_GAIN:
            return None
        precision = gain / usual[:, None] ** 2
        own = precision.diagonal()
        moved = np.where(known, readings, 0.0)
        moved = moved[None, :] - moved[:, None]  # what exchanging i and j adds to i, and takes from j
        after = before + 2.0 * moved * (weighed[:, None] - weighed[None, :])
        after += moved**2 * (own[:, None] + own[None, :] - 2.0 * precision)
        after[~(known[:, None] & known[None, :])] = math.inf
        i, j = divmod(int(after.argmin()), len(readings))
        found = before - after[i, j] > EXCHANGED_GAIN and after[i, j] < EXCHANGED_SHARE * before
        return (min(i, j), max(i, j)) if found else None

    def surprises(self, changes: Array) -> tuple[Array, Array]:
        """Return how far each change is from what the others' changes suggest, and how far readings usually are.

        Both of shape (S,) [K], as above.
        """
        known = np.isfinite(changes)
        gain, usual = self._made_ready(known)
        return gain @ np.where(known, changes, 0.0), usual

    def _made_ready(self, known: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return what makes differences (S,), 0 for those not known, to distances, and how far is usual."""
        key = known.tobytes()
        if key not in self._known:
            if len(self._known) >= MOST_PATTERNS:
                self._known.clear()
            gain, usual = np.zeros_like(self._total), np.full(len(known), np.inf)
            if known.sum() > 1:
                precision = np.linalg.inv(self._total[np.ix_(known, known)])
                own = precision.diagonal()
                gain[np.ix_(known, known)] = precision / own[:, None]
                usual[known] = 1.0 / np.sqrt(own)
            self._known[key] = gain, usual
        return self._known[key]
