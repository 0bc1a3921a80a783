"""One machine being served: its thermal state, what was served last, and the two joined on each request.

Nothing here waits, and the routes call it from one event loop without waiting in between, so requests cannot meet
inside it and it needs no lock.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from model.bundle import Bundle
from model.chain import Chain
from model.compensation import compensate
from model.error_map import ErrorMap
from model.exceptions import BundleError, ComputeError
from model.predictor import Predictor
from model.transforms import Array
from service.reach import Reach
from service.safety import LARGEST_TERM, Served, Target, advance, clip, is_usable
from service.schemas import Sample
from service.settings import Settings
from service.status import Condition, Status, most_serious
from service.survey import Survey
from service.thermal import Thermal, Zero

log = logging.getLogger(__name__)


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

    @property
    def status(self) -> Status:
        """The most serious condition."""
        return most_serious(self.conditions)

    @property
    def warnings(self) -> list[str]:
        """A sentence for each condition."""
        return [c.sentence for c in self.conditions if c.sentence is not None]


@dataclass(frozen=True)
class Receipt:
    """What became of telemetry samples."""

    accepted: int
    ignored: int
    warnings: list[str]


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
    """

    outlook: Outlook
    corrected: Array
    correction_mm: Array
    deviation_mm: Array
    limited: NDArray[np.bool_]
    predicted: ErrorMap
    tool_mm: Array | None


@dataclass
class Counts:
    """What has come in since the start: samples taken in, samples of no use, positions compensated."""

    accepted: int = 0
    refused: int = 0
    positions: int = 0


class MachineState:
    """A bundle being served.

    Parameters
    ----------
    bundle : a verified bundle
    settings : when telemetry is stale
    clock : the service's clock, epoch seconds
    steady : seconds that never jump, for the rate limit

    Raises
    ------
    BundleError
        where the network cannot be loaded, the geometric error terms are not those of a machine, or the machine is
        one whose rate of correction cannot be bounded yet.
    """

    def __init__(
        self, bundle: Bundle, settings: Settings, clock: Callable[[], float], steady: Callable[[], float]
    ) -> None:
        self.bundle = bundle
        self.machine = bundle.machine
        self.settings = settings
        self.clock, self.steady = clock, steady
        _check_servable(bundle)
        self.chain = Chain(bundle.machine)
        if not is_usable(bundle.geometry):
            raise BundleError(f"bundle '{bundle.path}': geometry.csv has a term beyond a metre or {LARGEST_TERM:g} rad")
        self.thermal: Thermal | None = None
        if bundle.manifest.network is not None:
            self.thermal = Thermal(Predictor(bundle), bundle.manifest.network, bundle.machine)
        self.served: Served | None = None
        self.counts = Counts()
        self._reach = Reach.of(self.chain)
        self._target = Target(bundle.geometry, None, 0.0)
        self._status = Status.OK

    def now(self, time_s: float | None = None) -> float:
        """Return the machine's clock: the service's, since clients' clocks are often wrong.

        In replay it is the time given, and never before the last served.
        """
        if not self.settings.replay:
            return self.clock()
        now_s = self.clock() if time_s is None else time_s
        return now_s if self.served is None else max(now_s, self.served.time_s)

    def passes(self, now_s: float) -> float:
        """Return the time on the clock that the rate limit goes by."""
        return now_s if self.settings.replay else self.steady()

    @property
    def zero(self) -> Zero:
        """The datum in force."""
        return Zero("absolute") if self.thermal is None else self.thermal.zero

    def take(self, samples: Sequence[Sample]) -> Receipt:
        """Advance the thermal state by samples, in the order of their times."""
        receipt = self._take(samples)
        self.counts.accepted += receipt.accepted
        self.counts.refused += receipt.ignored
        return receipt

    def _take(self, samples: Sequence[Sample]) -> Receipt:
        if self.thermal is None:
            unused = f"machine '{self.machine.name}' has no network, so telemetry does not change its correction"
            return Receipt(0, len(samples), [unused])
        accepted = failed = 0
        faults: Counter[str] = Counter()
        reasons: dict[str, str] = {}
        for sample in sorted(samples, key=lambda s: s.time):
            if not self.thermal.take(sample):
                failed += self.thermal.failure is not None
                continue
            accepted += 1
            found = {f"sensor '{n}'": f"{why}; replaced by its estimate" for n, why in self.thermal.faults.items()}
            found |= {f"channel '{n}'": why for n, why in self.thermal.held.items()}
            faults.update(found.keys())
            reasons |= found
        warnings = [f"{n} {reasons[n]}" + (f" ({c} samples)" if c > 1 else "") for n, c in faults.items()]
        late = len(samples) - accepted - failed
        if late:
            warnings.append(f"{late} of {len(samples)} samples are no newer than the thermal state and were ignored")
        if failed:
            warnings.append(f"{failed} of {len(samples)} samples were not used: {self.thermal.failure}")
        return Receipt(accepted, len(samples) - accepted, warnings)

    def outlook(self, now_s: float) -> Outlook:
        """Return what is predicted for a moment."""
        if self.thermal is None:
            return Outlook(now_s, self._target, (Condition(Status.GEOMETRIC_ONLY, None),))
        weight, conditions = self.thermal.outlook(now_s, self.settings)
        thermal = self.thermal.error_map()
        if thermal is not self._target.thermal or weight != self._target.weight:
            self._target = Target(self.bundle.geometry, thermal, weight)
        if not self._target.usable:
            sentence = "the predicted error terms are not usable numbers, so the last correction is held"
            conditions.append(Condition(Status.DEGRADED, sentence))
        return Outlook(now_s, self._target, tuple(conditions))

    def hand_out(self, tool_length_mm: float | None, now_s: float) -> tuple[Outlook, Served]:
        """Hand out the error map that is served now, for a client that compensates by itself.

        It counts as served, as corrections do: otherwise it could run ahead of the rate limit.

        Parameters
        ----------
        tool_length_mm : the longest tool that it is used with; None is the machine's own
        """
        outlook, served = self._advanced(tool_length_mm, now_s)
        self.served = served
        conditions = outlook.conditions + self._on_the_way(served)
        self._tell(most_serious(conditions))
        return Outlook(self.now(now_s), outlook.target, conditions), served

    def compensate(self, q: Array, tool_length_mm: float | None, now_s: float) -> Correction:
        """Hand out corrections for positions q of shape (n, A) [mm], moving what is served towards the target."""
        outlook, served = self._advanced(tool_length_mm, now_s)
        tool_mm = None
        if tool_length_mm is not None:
            tool_mm = tool_length_mm * np.asarray(self.machine.tool.direction)
        solved = compensate(self.chain, q, served.errors, tool_mm).corrected
        correction, clipped = clip(solved - q, self.machine.limits)
        predicted = outlook.target.errors if outlook.target.usable else served.errors
        deviation = self.chain.tip(q, predicted.evaluate(q), tool_mm) - self.chain.tip(q, None, tool_mm)
        if not (np.isfinite(correction).all() and np.isfinite(deviation).all()):
            raise ComputeError("corrections must be finite numbers, got others; nothing was served")
        self.served = served
        self.counts.positions += len(q)
        conditions = outlook.conditions + self._on_the_way(served) + self._bounded(int(clipped.sum()), q + correction)
        self._tell(most_serious(conditions))
        limited = clipped | (not served.arrived)
        at = Outlook(self.now(now_s), outlook.target, conditions)
        return Correction(at, q + correction, correction, deviation, limited, predicted, tool_mm)

    def largest_correction_um(self) -> float | None:
        """Return the largest correction over the working volume, as served last; None before anything was."""
        if self.served is None:
            return None
        return min(self._survey.largest_um(self.served.errors), self.machine.limits.max_correction_um)

    @cached_property
    def _survey(self) -> Survey:
        return Survey.of(self.chain)

    def _advanced(self, tool_length_mm: float | None, now_s: float) -> tuple[Outlook, Served]:
        """Return what is wanted and what may be served now, and serve nothing yet."""
        outlook = self.outlook(now_s)
        self._reach = self._reach.including(tool_length_mm)
        return outlook, advance(self.served, outlook.target, self.passes(now_s), self.machine.limits, self._reach)

    def evaluate(self, outlook: Outlook, q: Array) -> tuple[Array, Array]:
        """Return geometric and thermal error terms at positions, each of shape (n, K) [mm, rad].

        The thermal ones as they count: relative to the datum and times the weight.

        Raises
        ------
        ComputeError
            where the prediction is not usable.
        """
        target = outlook.target
        if not target.usable:
            raise ComputeError("the predicted error terms must be numbers of a machine's size, got others")
        thermal = ErrorMap.zero(self.machine) if target.thermal is None else target.thermal
        return target.geometric.evaluate(q), thermal.scaled(target.weight).evaluate(q)

    def _on_the_way(self, served: Served) -> tuple[Condition, ...]:
        """Return what the rate limit did."""
        if served.arrived or served.held:
            return ()
        sentence = (
            f"the correction is up to {served.remaining_um:.3g} µm from its target and moves there at no more "
            f"than {self.machine.limits.max_rate_um_per_min:g} µm/min"
        )
        return (Condition(Status.OK, sentence),)

    def _bounded(self, clipped: int, corrected: Array) -> tuple[Condition, ...]:
        """Return what the absolute limit did, and corrected coordinates that leave their axis' range."""
        sentences: list[str] = []
        if clipped:
            most_um = self.machine.limits.max_correction_um
            sentences.append(f"{clipped} positions are limited to ±{most_um:g} µm on an axis")
        for column, name in enumerate(self.machine.axis_names):
            axis = self.machine.axes[name]
            leaving = int(((corrected[:, column] < axis.low) | (corrected[:, column] > axis.high)).sum())
            if leaving:
                sentences.append(
                    f"{leaving} corrected positions leave the range {axis.low:g} ... {axis.high:g} mm of axis '{name}'"
                )
        return tuple(Condition(Status.OK, s) for s in sentences)

    def _tell(self, status: Status) -> None:
        if status != self._status:
            log.info("status changed", extra={"machine": self.machine.name, "status": status.value})
            self._status = status


def _check_servable(bundle: Bundle) -> None:
    machine = bundle.machine
    rotary = [a for a in machine.axis_names if machine.axes[a].rotary]
    if rotary or len(machine.tool_names) > 1:
        what = f"rotary axes {', '.join(rotary)}" if rotary else f"the tools {', '.join(machine.tool_names)}"
        raise BundleError(
            f"bundle '{bundle.path}': a machine to serve must have linear axes and one tool, got {what}; "
            "`thermotrue compensate` takes it"
        )
