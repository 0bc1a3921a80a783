"""One machine being served: its thermal state, what was served last, and the two joined on each request.

Nothing here waits, and the routes call it from one event loop without waiting in between, so requests cannot meet
inside it and it needs no lock.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

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
    """

    outlook: Outlook
    corrected: Array
    correction_mm: Array
    deviation_mm: Array
    limited: NDArray[np.bool_]


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

    @property
    def zero(self) -> Zero:
        """The datum in force."""
        return Zero("absolute") if self.thermal is None else self.thermal.zero

    def take(self, samples: Sequence[Sample]) -> Receipt:
        """Advance the thermal state by samples, in the order of their times."""
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

    def compensate(self, q: Array, tool_length_mm: float | None, now_s: float) -> Correction:
        """Hand out corrections for positions q of shape (n, A) [mm], moving what is served towards the target."""
        outlook = self.outlook(now_s)
        limits = self.machine.limits
        tool_mm = None
        if tool_length_mm is not None:
            tool_mm = tool_length_mm * np.asarray(self.machine.tool.direction)
        self._reach = self._reach.including(tool_length_mm)
        passes_s = now_s if self.settings.replay else self.steady()
        served = advance(self.served, outlook.target, passes_s, limits, self._reach)
        solved = compensate(self.chain, q, served.errors, tool_mm).corrected
        correction, clipped = clip(solved - q, limits)
        target = outlook.target.errors if outlook.target.usable else served.errors
        deviation = self.chain.tip(q, target.evaluate(q), tool_mm) - self.chain.tip(q, None, tool_mm)
        if not (np.isfinite(correction).all() and np.isfinite(deviation).all()):
            raise ComputeError("corrections must be finite numbers, got others; nothing was served")
        self.served = served
        conditions = outlook.conditions + self._on_the_way(served, int(clipped.sum()), q + correction)
        self._tell(most_serious(conditions))
        limited = clipped | (not served.arrived)
        return Correction(
            Outlook(self.now(now_s), outlook.target, conditions), q + correction, correction, deviation, limited
        )

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

    def _on_the_way(self, served: Served, clipped: int, corrected: Array) -> tuple[Condition, ...]:
        """Return what the limits did, and corrected coordinates that leave their axis' range."""
        sentences: list[str] = []
        limits = self.machine.limits
        if not served.arrived and not served.held:
            sentences.append(
                f"the correction is up to {served.remaining_um:.3g} µm from its target and moves there at no more "
                f"than {limits.max_rate_um_per_min:g} µm/min"
            )
        if clipped:
            sentences.append(f"{clipped} positions are limited to ±{limits.max_correction_um:g} µm on an axis")
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
