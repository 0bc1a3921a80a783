"""What a machine says to a request: what is predicted, what became of samples, corrections."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from model.error_map import ErrorMap
from model.transforms import Array
from service.safety import Target
from service.status import Condition, Status, most_serious


@dataclass(frozen=True)
class Outlook:
    """What is predicted for one moment, before the limits.

    Attributes
    ----------
    now_s : the machine's clock
    target : the error map wanted
    conditions : every reason not to trust it fully
    """

    now_s: float
    target: Target
    conditions: tuple[Condition, ...]

    @cached_property
    def status(self) -> Status:
        """The most serious condition."""
        return most_serious(self.conditions)

    @property
    def warnings(self) -> list[str]:
        """A sentence for each condition."""
        return [c.sentence for c in self.conditions if c.sentence is not None]


@dataclass(frozen=True)
class Receipt:
    """What became of telemetry samples.

    Attributes
    ----------
    recorded : whether all of them wait to be stored, or are; otherwise they have to be sent again
    """

    accepted: int
    ignored: int
    warnings: list[str]
    recorded: bool = True


@dataclass(frozen=True)
class Correction:
    """Corrections of n positions.

    Attributes
    ----------
    outlook : what they are on their way to
    corrected, correction_mm : shape (n, A) [mm]
    deviation_mm : shape (n, 3), predicted at the programmed positions, not limited
    limited : shape (n,)
    predicted : the error map that the deviations come from
    tool_mm : tool tip in the tool frame; None is the machine's own
    uncertainty_um : half width of the 95 % interval of each deviation, shape (n,); None where it is not known
    """

    outlook: Outlook
    corrected: Array
    correction_mm: Array
    deviation_mm: Array
    limited: NDArray[np.bool_]
    predicted: ErrorMap
    tool_mm: Array | None
    uncertainty_um: Array | None


@dataclass
class Counts:
    """What has come in since the start: samples taken in, samples of no use, positions compensated."""

    accepted: int = 0
    refused: int = 0
    positions: int = 0
