"""What a lost sensor would have contributed, estimated from all other inputs and their past.

The network feels a sensor by its value and by its thermal modes, the value passed through lags. Both are estimated by
their conditional mean given the values and modes of the other sensors and the modes of the heat sources, under a joint
normal distribution of them all. So the estimate knows what the channels say, and the past.

What the estimate misses does not change at once. A sensor that is lost in service was known before, so its estimate
starts where it was and the difference fades: with m what is estimated, G z the conditional mean and r = exp(-Δt / its
memory), m' = G z' + r (m - G z). One step and two half steps give the same. The share of the variance that is not known
any more, the doubt, follows: 1 - v' = r² (1 - v). When the sensor is back, its value is known at once and the doubt of
its modes fades with their time constants. Made by `training/lost_sensors.py`.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.exceptions import BundleError
from model.manifest import LostSensorRecord
from model.transforms import Array

SOURCE = 2.0
"""Size of a heat source at full load beside a typical swing of a temperature (chosen, as `noise`: bench/lost_sensor.py
with other values leaves more)."""
PATTERNS = 256
"""Sets of lost sensors whose estimates are kept at hand: a machine whose sensors come and go has few of them."""
LEAST_DOUBT = 1e-6
"""Share of the variance below which an estimate counts as known: a thousandth of the standard deviation."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Given:
    """The estimate of some features from the others, all of them scaled.

    Attributes
    ----------
    lost : which they are, shape (F,)
    gain : shape (F - L, L)
    roots : shape (L, L), roots' @ roots is the covariance of what it misses
    """

    lost: Mask
    gain: Array
    roots: Array


class LostSensors:
    """Conditional distribution of a machine's features: each sensor's value and modes, and the sources' modes.

    Attributes
    ----------
    sources : Q

    Parameters
    ----------
    record : of the manifest
    sensors, sources : S and Q
    time_constants_s : of the modes, length K

    Raises
    ------
    BundleError
        where the record is of other numbers of sensors, sources or modes.
    """

    def __init__(self, record: LostSensorRecord, sensors: int, sources: int, time_constants_s: Array) -> None:
        self._factors = np.array(record.factors)  # (R, F)
        self._mean = np.array(record.mean)
        self._noise, self._swing_K, self._scale = record.noise, record.swing_K, record.scale
        self._memory_s = np.array(record.memory_s)
        self.sources, self._width = sources, len(time_constants_s) + 1
        self._patterns: dict[bytes, Given] = {}
        self._lock = threading.Lock()
        features = sensors * self._width + sources * len(time_constants_s)
        if (
            self._factors.ndim != 2
            or self._factors.shape[1] != features
            or self._mean.shape != (features,)
            or self._memory_s.shape != (self._width,)
        ):
            raise BundleError(
                f"lost sensors in the manifest must be told by {features} features of {sensors} sensors and {sources} "
                f"heat sources, got {self._factors.shape[-1]}; export the bundle again"
            )

    def features(self, values: Array, filtered: Array, sources: Array, first: Array | None) -> Array:
        """Return the scaled features, shape (F,).

        Parameters
        ----------
        values, filtered : of the sensors, shape (S,) and (S, K) [°C]
        sources : modes of the heat sources, shape (Q, K)
        first : temperatures that changes count from, shape (S,) [°C], where the network knows only changes
        """
        degC = np.concatenate([values[:, None], filtered], axis=1)
        if first is not None:
            degC = degC - first[:, None]
        own = len(self._mean) - sources.size
        loads = SOURCE * (sources.ravel() - self._mean[own:])
        return np.concatenate([(degC.ravel() - self._mean[:own]) / self._swing_K, loads])

    def given(self, missing: Mask) -> Given:
        """Return how the features of missing sensors (S,) are estimated from all others."""
        key = missing.tobytes()
        with self._lock:  # machines of one type share this, and one may be led through telemetry in a thread
            found = self._patterns.pop(key, None) or self._given(missing)
            self._patterns[key] = found  # the last used come last
            if len(self._patterns) > PATTERNS:
                del self._patterns[next(iter(self._patterns))]
        return found

    def estimate(self, given: Given, features: Array) -> Array:
        """Return the conditional mean of the features (L,) of missing sensors, scaled."""
        found: Array = features[~given.lost] @ given.gain
        return found

    def degC(self, estimated: Array, missing: Mask, first: Array | None) -> Array:
        """Return scaled features (L,) of missing sensors in °C, shape (number of them, 1 + K)."""
        own = len(missing) * self._width
        mean = self._mean[:own].reshape(-1, self._width)[missing]
        found: Array = estimated.reshape(-1, self._width) * self._swing_K + mean
        return found if first is None else found + first[missing, None]

    def kept(self, dt_s: float) -> Array:
        """Return what share of the difference from the conditional mean is left after a step, shape (1 + K,)."""
        return np.asarray(np.exp(-dt_s / self._memory_s))

    def missed(self, doubt: Array) -> tuple[Mask, Array]:
        """Return what the present estimates may miss: of which sensors (S,), and its roots (L, L) [K].

        The covariance of their values and modes, one sensor after the other, is roots' @ roots.

        Parameters
        ----------
        doubt : shape (S, 1 + K), the share of each one's variance that is not known
        """
        missing: Mask = np.asarray((doubt > 0.0).any(axis=1))
        roots = self.given(missing).roots * np.sqrt(doubt[missing].ravel())
        return missing, roots * (self._swing_K * self._scale)

    def _given(self, missing: Mask) -> Given:
        lost = np.zeros(len(self._mean), dtype=bool)
        lost[: len(missing) * self._width] = np.repeat(missing, self._width)
        own, others = self._factors[:, lost], self._factors[:, ~lost]
        # Woodbury: the features are factors' @ a plus noise, with a standard normal.
        inner = np.linalg.solve(self._noise * np.eye(len(others)) + others @ others.T, own)
        values, vectors = np.linalg.eigh(self._noise * (own.T @ inner + np.eye(own.shape[1])))
        return Given(lost, others.T @ inner, (vectors * np.sqrt(np.maximum(values, 0.0))).T)


def stepped_doubt(doubt: Array, missing: Mask, kept: Array, faded: Array) -> Array:
    """Return the doubt (S, 1 + K) after a step.

    Parameters
    ----------
    missing : sensors without a reading now, shape (S,)
    kept : share of the difference from the estimate that lasts while a sensor is lost, shape (1 + K,)
    faded : share of an error in the modes that lasts while it is there, shape (1 + K,); the value's is 0
    """
    lost = 1.0 - kept**2 * (1.0 - doubt)
    found: Array = np.where(missing[:, None], lost, doubt * faded**2)
    return np.where(found < LEAST_DOUBT, 0.0, found)
