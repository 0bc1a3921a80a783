"""What the baselines see of a run: temperatures, channels, and exponential moving averages of both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.sensors import SensorModel
from model.telemetry import Run
from model.transforms import Array
from training.dataset import DataSet

TAUS_S = (120.0, 400.0, 1200.0, 3600.0, 10800.0, 36000.0)
"""Time constants of the moving averages [s]: log-spaced from two minutes to ten hours, as the network's are."""


@dataclass(frozen=True)
class Inputs:
    """Brings telemetry to what the baselines see.

    Attributes
    ----------
    sensors : S, the first of the inputs; channels follow
    offset, scale : shape (S + C,), of typical size 1 is (value - offset) / scale
    relative : whether only changes since a run's first sample count
    """

    sensors: int
    offset: Array
    scale: Array
    relative: bool
    sensor_model: SensorModel

    @classmethod
    def of(cls, dataset: DataSet, train_runs: list[str], sensor_model: SensorModel) -> Inputs:
        """Return the inputs scaled by the training runs.

        One scale serves all sensors, a typical swing within a run, since a kelvin is a kelvin; each channel has its
        largest value.
        """
        telemetry = [dataset.runs[name].telemetry for name in train_runs]
        filled = [sensor_model.fill(t.temperatures) for t in telemetry]
        swing = float(np.sqrt(np.mean(np.concatenate([f - f.mean(axis=0) for f in filled]) ** 2)))
        largest = np.abs(np.concatenate([t.channels for t in telemetry])).max(axis=0)
        sensors = len(dataset.sensors)
        reference = np.full(sensors, dataset.machine.reference_temperature_degC)
        return cls(
            sensors,
            np.concatenate([reference, np.zeros(len(largest))]),
            np.concatenate([np.full(sensors, swing or 1.0), np.where(largest > 0, largest, 1.0)]),
            dataset.datum == "run-start",
            sensor_model,
        )

    @property
    def channels(self) -> int:
        """C."""
        return len(self.scale) - self.sensors

    def drive(self, telemetry: Run) -> Array:
        """Return temperatures and channels (T, S + C), of typical size 1; for run-start data the temperatures' change.

        Channels keep their zero, since an idle machine makes no heat.
        """
        raw = np.concatenate([self.sensor_model.fill(telemetry.temperatures), telemetry.channels], axis=1)
        drive: Array = (raw - self.offset) / self.scale
        if self.relative:
            drive[:, : self.sensors] -= drive[0, : self.sensors]
        return drive

    def averages(self, telemetry: Run) -> Array:
        """Return inputs and their moving averages, shape (T, S + C, 1 + K).

        At a first sample the temperatures' averages are in equilibrium with it, and the channels' zero. For run-start
        data all count from there.
        """
        drive = self.drive(telemetry)
        state = np.zeros((drive.shape[1], len(TAUS_S)))
        state[: self.sensors] = drive[0, : self.sensors, None]
        found = np.empty((*drive.shape, 1 + len(TAUS_S)))
        found[:, :, 0] = drive
        found[0, :, 1:] = state
        ratio = np.diff(telemetry.time_s)[:, None] / np.array(TAUS_S)
        keep = np.exp(-ratio)
        # First-order hold: the input runs linearly between samples, so irregular steps are exact.
        phi = -np.expm1(-ratio) / ratio
        for i in range(1, len(drive)):
            pushed = drive[i - 1, :, None] * (phi - keep)[i - 1] + drive[i, :, None] * (1.0 - phi[i - 1])
            state = keep[i - 1] * state + pushed
            found[i, :, 1:] = state
        return found - found[:1] if self.relative else found
