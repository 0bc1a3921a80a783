"""How far to rely on a prediction: a number between 0 and 1. Pure functions.

It is the product of two shares, both 1 where nothing is wrong. With sensors lost, the share of the drift's variance
that is still explained, 1 - missed² / drift², with missed² the variance of what their estimates miss. In a thermal
state beyond those that training left out in turn, drift² / (drift² + missed²), with missed² what the leverage of the
state adds to the variance: there the prediction is an extrapolation, the deviation plus an error of its own, and so
multiplied it is the best estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from model.transforms import Array


@dataclass(frozen=True)
class Missed:
    """What a prediction misses at the tip beyond what it usually does, root mean squares over the working volume.

    Attributes
    ----------
    drift_um : the tip's drift in training
    lost_um : of the estimates of lost sensors
    beyond_um : of a thermal state unlike those of the training
    """

    drift_um: float
    lost_um: float
    beyond_um: float

    @property
    def reliability(self) -> float:
        """Return how far to rely on the prediction."""
        return self.of_lost * self.of_state

    @property
    def of_lost(self) -> float:
        """Return what the lost sensors leave of it."""
        return explained(self.drift_um, self.lost_um)

    @property
    def of_state(self) -> float:
        """Return what the thermal state leaves of it."""
        # By the drift that training had, and not by the one predicted: far outside, that grows with the state as its
        # error does, and would vouch for itself.
        return shrunk(self.drift_um, self.beyond_um)


def explained(drift_um: float, missed_um: float) -> float:
    """Return the share of a drift's variance that is still explained when a part is missed: 1 - missed² / drift².

    From 0, also where a number is not finite, to 1; never larger when more is missed.
    """
    if missed_um == 0.0:
        return 1.0
    return 1.0 - (missed_um / drift_um) ** 2 if missed_um < drift_um else 0.0


def shrunk(drift_um: float, missed_um: float) -> float:
    """Return by what to multiply a drift with an independent error for the best estimate: drift² / (drift² + missed²).

    From 0, also where a number is not finite, to 1; never larger when more is missed.
    """
    if missed_um == 0.0:
        return 1.0
    if not (drift_um > 0.0 and math.isfinite(missed_um)):
        return 0.0
    return (drift_um / math.hypot(drift_um, missed_um)) ** 2


def tip_rms_um(directions: Array, form: Array) -> float:
    """Return the root mean square at the tip [µm] of coefficients with covariance Σ d d', of directions d (R, P).

    `form` (P, P) gives the tip's mean square over the working volume.
    """
    return float(np.sqrt(max(float(((directions @ form) * directions).sum()), 0.0)))


def beyond_um(size: float, largest_size: float, directions: Array, form: Array) -> float:
    """Return by how much more the prediction misses at the tip [µm] than in any state that training left out.

    Parameters
    ----------
    size : how many times as far off as usual the prediction may be (`Uncertainty.size`)
    largest_size : of the states that training left out in turn: so far it is known how far off predictions are
    directions : of the coefficients' covariance for size 1, shape (R, P)
    """
    excess = size**2 - largest_size**2
    return float(np.sqrt(excess)) * tip_rms_um(directions, form) if excess > 0.0 else 0.0
