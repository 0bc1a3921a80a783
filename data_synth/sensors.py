"""Thermometers: where they sit, how late they are, how far off, how they age and round."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from data_synth.environment import lag
from data_synth.network import Array

CALIBRATION_STREAM = 2**32 - 2
"""Beside the seed, where a run has its number: what is drawn once for a machine and all its runs."""
CHECKED_H, WALK_STEP_H = 8760.0, 24.0
"""Thermometers are checked once a year; between checks their walk is known day by day (chosen)."""


@dataclass(frozen=True)
class Calibration:
    """How far off a thermometer of a machine is when a run starts: it shows felt (1 + gain) + offset.

    Attributes
    ----------
    offset_K : at 0 °C; +0.2 K shows 0.2 °C in melting ice
    gain : relative error of temperatures in °C; +0.005 shows 0.5 K too much at 100 °C
    """

    offset_K: float = 0.0
    gain: float = 0.0


EXACT = Calibration()


@dataclass(frozen=True)
class Thermometer:
    """One sensor.

    Attributes
    ----------
    at : nodes and boundaries it feels, by share
    lag_s : time constant of the sensor in its bore or under its clamp
    noise_K, step_K : spread of its noise; what it is rounded to, 0 for not at all
    offset_K, gain : largest offset and relative error it is delivered with
    drift_K : spread of its calibration's random walk after 1000 h, after t hours sqrt(t / 1000) times that
    """

    at: Mapping[str, float]
    lag_s: float = 30.0  # a clamped resistance thermometer needs half a minute to two (chosen)
    noise_K: float = 0.05  # as logged by common input modules, 0.03 to 0.1 K (chosen)
    step_K: float = 0.1  # PLC words carry tenths of a degree
    offset_K: float = 0.3  # Pt100 of class B, ±(0.30 + 0.005 |t|) K (IEC 60751:2022)
    gain: float = 0.005
    # 0.15 K in a year (chosen): half of what the type test allows, in which ten cycles over the whole range may
    # move the reading at 0 °C by the tolerance (IEC 60751:2008, 6.5.5).
    drift_K: float = 0.05

    def calibrated(self, name: str, seed: int, age_h: float) -> Calibration:
        """Return its calibration `age_h` after the last check, a function of its name and the seed alone.

        Parameters
        ----------
        name : of machine and sensor; another name is another specimen
        seed : of the data set, so that all its runs have the same thermometers
        age_h : from 0 to a year [h]; two runs on one day find the same calibration
        """
        rng = np.random.default_rng((seed, CALIBRATION_STREAM, zlib.crc32(name.encode())))
        # Only limits are known of what leaves the factory, so all within is as likely (JCGM 100:2008, 4.3.7).
        offset, gain = rng.uniform(-self.offset_K, self.offset_K), rng.uniform(-self.gain, self.gain)
        walk = self._walk(round(CHECKED_H / WALK_STEP_H) + 1, 3600.0 * WALK_STEP_H, rng)
        return Calibration(float(offset + np.interp(age_h / WALK_STEP_H, np.arange(len(walk)), walk)), float(gain))

    def read(
        self,
        temperatures: Mapping[str, Array],
        period_s: float,
        rng: np.random.Generator,
        calibration: Calibration = EXACT,
    ) -> Array:
        """Return what it shows of the true temperatures (t,) by name [°C].

        Its lag is exact for temperatures that run straight between samples and its walk keeps its spread, whatever
        the period; the noise of one reading and the next is independent.
        """
        felt = sum((share * temperatures[name] for name, share in self.at.items()), start=np.float64(0.0))
        late = lag(np.asarray(felt), self.lag_s, period_s)
        off = calibration.offset_K + calibration.gain * late + self._walk(len(late), period_s, rng)
        return rounded(late + off + rng.normal(0.0, self.noise_K, len(late)), self.step_K)

    def _walk(self, n: int, step_s: float, rng: np.random.Generator) -> Array:
        """Return a random walk from 0, shape (n,) [K]."""
        steps = rng.normal(0.0, self.drift_K * np.sqrt(step_s / 3.6e6), n)
        steps[:1] = 0.0
        walk: Array = np.cumsum(steps)
        return walk


def rounded(values: Array, step_K: float) -> Array:
    """Return values as multiples of a step, 0 for all digits, without what binary fractions add to them."""
    if step_K <= 0.0:
        return values
    shown: Array = np.round(np.rint(values / step_K) * step_K, 6)
    return shown
