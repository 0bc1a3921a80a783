"""Put the estimates of lost sensors into the state of a network that knows only complete inputs."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from model.exceptions import BundleError
from model.lost_sensors import LostSensors, Mask
from model.manifest import NetworkRecord
from model.reliability import tip_rms_um
from model.transforms import Array

Run = Callable[[Array, Array, Array, Array, Array], tuple[Array, Array]]
"""The network's step for a batch: inputs, previous, modes, dt_s, fresh; returns modes and coefficients."""


class Replacement:
    """The estimates of one network's lost sensors.

    The network's modes of temperatures are those of mixed and scaled ones. How they are mixed is asked of the network
    itself: a first sample is its own mode.

    Parameters
    ----------
    record : of the network, with `lost_sensors`
    run : the network's step
    form : the tip's mean square over the working volume as a quadratic form of the coefficients, (P, P)

    Raises
    ------
    BundleError
        where the record does not fit the network.
    """

    def __init__(self, record: NetworkRecord, run: Run, form: Array) -> None:
        assert record.lost_sensors is not None
        self._run, self._form = run, form
        self._tau_s = np.array(record.time_constants_s)
        self._sensors, self._channels = len(record.sensors), len(record.channels)
        drives = record.modes // len(self._tau_s)
        self.lost = LostSensors(record.lost_sensors, self._sensors, drives - self._sensors, self._tau_s)
        self._mean_degC = np.array(record.sensor_mean_degC)
        probes = np.concatenate([self._mean_degC[None], self._mean_degC + np.eye(self._sensors)])
        drive = self._modes_of(self._start(probes))[:, : self._sensors, 0]
        self._mix, self._at_mean = drive[1:] - drive[0], drive[0]  # drive = (temperatures - mean) @ mix + at_mean
        if not np.linalg.cond(self._mix) < 1e9:
            raise BundleError("lost sensors can be told only of a network that mixes temperatures invertibly")
        self._unmix = np.linalg.inv(self._mix)

    def replaced(
        self, inputs: Array, modes: Array, missing: Mask, first: Array | None, before: tuple[Array, Array, float] | None
    ) -> tuple[Array, Array]:
        """Return inputs (S + C,) and modes (M,) with the estimates of missing sensors (S,) in them.

        Parameters
        ----------
        inputs, modes : with anything finite in their place
        first : temperatures that changes count from, None where the network knows absolute deviations
        before : inputs and modes at the sample before, and the time since then [s]; None at a first sample
        """
        given = self.lost.given(missing)
        features = self._features(inputs, modes, first)
        estimated = self.lost.estimate(given, features)
        if before is not None:
            inputs_before, modes_before, dt_s = before
            features = self._features(inputs_before, modes_before, first)
            off = features[given.lost] - self.lost.estimate(given, features)
            estimated = estimated + np.tile(self.lost.kept(dt_s), int(missing.sum())) * off
        degC = self.lost.degC(estimated, missing, first)
        inputs, modes = inputs.copy(), self._modes_of(modes).copy()
        inputs[: self._sensors][missing] = degC[:, 0]
        filtered = self._filtered(modes)
        filtered[missing] = degC[:, 1:]
        modes[: self._sensors] = ((filtered - self._mean_degC[:, None]).T @ self._mix + self._at_mean).T
        return inputs, modes.ravel()

    def missed_um(self, doubt: Array) -> float:
        """Return what the estimates miss at the tip, root mean square over the working volume [µm].

        Parameters
        ----------
        doubt : shape (S, 1 + K), see `model/lost_sensors.py`
        """
        if not doubt.any():
            return 0.0
        missing, roots = self.lost.missed(doubt)
        return tip_rms_um(roots @ self._effects[missing].reshape(roots.shape[1], -1), self._form)

    @cached_property
    def _effects(self) -> Array:
        """Effect on the coefficients of 1 K of each sensor's value and modes, shape (S, 1 + K, P), at the mean."""
        count, width = self._sensors, len(self._tau_s) + 1
        inputs = np.concatenate([self._mean_degC, np.zeros(self._channels)])
        modes = self._modes_of(self._start(self._mean_degC[None]))[0]
        all_inputs = np.tile(inputs, (count, width, 1))
        all_modes = np.tile(modes, (count, width, 1, 1))
        for sensor in range(count):
            all_inputs[sensor, 0, sensor] += 1.0
            for k in range(1, width):
                all_modes[sensor, k, :count, k - 1] += self._mix[sensor]
        stacked = np.concatenate([inputs[None], all_inputs.reshape(count * width, -1)])
        held = np.concatenate([modes.reshape(1, -1), all_modes.reshape(count * width, -1)])
        still = np.zeros((len(stacked), 1))
        coefficients = self._run(stacked, stacked, held, still, still)[1]
        found: Array = (coefficients[1:] - coefficients[0]).reshape(count, width, -1)
        return found

    def _start(self, temperatures: Array) -> Array:
        """Return the modes (n, M) at first samples of temperatures (n, S), channels at zero."""
        inputs = np.concatenate([temperatures, np.zeros((len(temperatures), self._channels))], axis=1)
        rows = (len(inputs), 1)
        drives = np.zeros((len(inputs), self._drives * len(self._tau_s)))
        return self._run(inputs, inputs, drives, np.zeros(rows), np.ones(rows))[0]

    @property
    def _drives(self) -> int:
        return self.lost.sources + self._sensors

    def _modes_of(self, modes: Array) -> Array:
        """Return modes (..., M) as (..., drives, K)."""
        return modes.reshape(*modes.shape[:-1], self._drives, len(self._tau_s))

    def _filtered(self, modes: Array) -> Array:
        """Return the sensors' temperatures behind each lag, shape (S, K) [°C], of modes (drives, K)."""
        found: Array = ((modes[: self._sensors].T - self._at_mean) @ self._unmix).T + self._mean_degC[:, None]
        return found

    def _features(self, inputs: Array, modes: Array, first: Array | None) -> Array:
        shaped = self._modes_of(modes)
        return self.lost.features(inputs[: self._sensors], self._filtered(shaped), shaped[self._sensors :], first)
