"""Thermometers: where they sit, how late they are, how they round."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from data_synth.environment import lag
from data_synth.network import Array


@dataclass(frozen=True)
class Thermometer:
    """One sensor.

    Attributes
    ----------
    at : nodes and boundaries it feels, by share
    lag_s : time constant of the sensor in its bore or under its clamp
    noise_K, step_K : spread of its noise; what it is rounded to
    """

    at: Mapping[str, float]
    lag_s: float = 30.0  # a clamped resistance thermometer needs half a minute to two (chosen)
    noise_K: float = 0.05  # as logged by common input modules, 0.03 to 0.1 K (chosen)
    step_K: float = 0.1  # PLC words carry tenths of a degree

    def read(self, temperatures: Mapping[str, Array], period_s: float, rng: np.random.Generator) -> Array:
        """Return what it shows of the true temperatures (t,) by name [°C]."""
        felt = sum((share * temperatures[name] for name, share in self.at.items()), start=np.float64(0.0))
        late = lag(np.asarray(felt), self.lag_s, period_s)
        shown: Array = np.rint((late + rng.normal(0.0, self.noise_K, len(late))) / self.step_K) * self.step_K
        return np.round(shown, 6)
