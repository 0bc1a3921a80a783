"""How a bundle came about, beyond what its manifest keeps: for the report."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from model.predictor import Predictor
from training.choice import Choice
from training.split import Split
from training.trainer import Training


class Stopwatch:
    """Times the parts of some work, one after the other."""

    def __init__(self) -> None:
        self._since = time.monotonic()
        self.seconds: dict[str, float] = {}

    def lap(self, part: str) -> None:
        """Count the time since the last lap to `part`."""
        now = time.monotonic()
        self.seconds[part] = self.seconds.get(part, 0.0) + now - self._since
        self._since = now

    def count(self, part: str, seconds: float) -> None:
        """Count time that was taken now or before a checkpoint."""
        self._since = time.monotonic()
        self.seconds[part] = self.seconds.get(part, 0.0) + seconds


@dataclass(frozen=True)
class Making:
    """What a training job leaves behind.

    Attributes
    ----------
    split : what was left out to measure the network
    predictor : the network without the left-out part, which the scores are of
    measured : the same, with how the residual fared on the folds
    served : the network in the bundle; the same as `measured` where the left-out part stays out of it
    seconds : time that each part of the job took [s]
    choice : of the prior's sizes and the penalty
    """

    split: Split
    predictor: Predictor
    measured: Training
    served: Training
    seconds: dict[str, float] = field(default_factory=dict)
    choice: Choice | None = None
