"""One machine being served: its thermal state, what was served last, and the two joined on each request.

Nothing here waits, and the routes call it from one event loop without waiting in between, so requests cannot meet
inside it and it needs no lock.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from model.bundle import Bundle
from model.chain import Chain
from model.error_map import ErrorMap
from model.exceptions import BundleError, ComputeError
from model.shared_predictors import predictor_of
from model.transforms import Array
from service.boot import boot_id
from service.measurements.history import ARRIVED_UM, History, Past
from service.measurements.monitor import Monitor
from service.outcome import Correction, Counts, Outlook, Receipt
from service.reach import Reach
from service.recorder import Recorder
from service.safety import LARGEST_TERM, Served, Target, advance, is_usable, longest_way_s
from service.schemas import Sample
from service.settings import Settings
from service.snapshot import Snapshot
from service.solver import Solved, Solver, Solvers
from service.status import Condition, Status, most_serious
from service.survey import Survey
from service.thermal import MAX_AHEAD_S, Thermal, Zero
from service.uncertainty import Interval, unapplied_um

log = logging.getLogger(__name__)


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

    KEPT = ("served", "counts", "watchers", "recorder", "monitor", "_reach", "_status", "_came_s")
    """What belongs to the machine and not to its bundle: `adopt` keeps it."""

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
            self.thermal = Thermal(predictor_of(bundle), bundle.manifest.network, bundle.machine)
        self.served: Served | None = None
        self.counts = Counts()
        self.watchers: list[list[Sample]] = []
        self.recorder: Recorder | None = None
        self.monitor = Monitor()
        self.history = History()
        self._reach = Reach.of(self.chain)
        self._solvers = Solvers(self.chain)
        self._target = Target(bundle.geometry, None, 0.0)
        self._status = Status.OK
        self._came_s: float | None = None  # when telemetry came last, on the steady clock; None before it did

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

    def adopt(self, other: MachineState) -> None:
        """Go on with another bundle of the same machine: its network, state and limits, from where this one serves.

        What is served stays, so the correction moves to the other prediction no faster than the rate, and the time
        before counts for the way to the old one. It happens in place, since streams hold on to a machine for long.
        """
        if self.served is not None and not self.settings.replay:
            self.served = self._advanced(None, self.now())[1]
        kept = {name: value for name, value in vars(self).items() if name in self.KEPT}
        vars(self).clear()
        vars(self).update({**vars(other), **kept})
        self._tell(self.outlook(self.now()).status)

    def take(self, samples: Sequence[Sample]) -> Receipt:
        """Advance the thermal state by samples, in the order of their times.

        `watchers` get them, too: a model that is about to be activated.
        """
        for watcher in self.watchers:
            watcher.extend(samples)
        receipt = self._take(samples)
        self.counts.accepted += receipt.accepted
        self.counts.refused += receipt.ignored
        return receipt

    def _take(self, samples: Sequence[Sample]) -> Receipt:
        if self.thermal is None:
            unused = f"machine '{self.machine.name}' has no network, so telemetry does not change its correction"
            return Receipt(0, len(samples), [unused])
        accepted = 0
        taken: list[Sample] = []
        late: list[Sample] = []
        faults: Counter[str] = Counter()
        reasons: dict[str, str] = {}
        for sample in sorted(samples, key=lambda s: s.time):
            if self.thermal.state is not None and sample.time <= self.thermal.state.time_s:
                late.append(sample)
                continue
            taken.append(sample)
            if not self.thermal.take(sample):
                continue
            accepted += 1
            if self.history.is_due(sample.time):
                self.history.note(self.past())
            found = {f"sensor '{n}'": f"{why}; replaced by its estimate" for n, why in self.thermal.faults.items()}
            found |= {f"channel '{n}'": why for n, why in self.thermal.held.items()}
            faults.update(found.keys())
            reasons |= found
        if accepted:
            self._came_s = self.steady()
        warnings = [f"{n} {reasons[n]}" + (f" ({c} samples)" if c > 1 else "") for n, c in faults.items()]
        if late:
            warnings.append(
                f"{len(late)} of {len(samples)} samples are no newer than the thermal state and were ignored"
            )
        if failed := len(taken) - accepted:
            why = self.thermal.failure or "a later one was"
            warnings.append(f"{failed} of {len(samples)} samples were not used: {why}")
        recorded = self.recorder is None or self.recorder.samples(taken, late)
        return Receipt(accepted, len(samples) - accepted, warnings, recorded)

    def snapshot(self, *, last: bool = False) -> Snapshot:
        """Return all that another process needs to go on from here; `last` where nothing is served after it."""
        reach = self._reach
        lengths = reach.shortest_mm, reach.longest_mm
        tools = None if lengths[0] is None or lengths[1] is None else (lengths[0], lengths[1])
        memory = None if self.thermal is None else self.thermal.memory()
        return Snapshot(self.bundle.version, memory, self.served, tools, boot_id(), last=last)

    def resume(self, snapshot: Snapshot) -> None:
        """Go on from what was served last; the thermal part is restored by `service.restore`.

        The time since then counts for the rate limit where the clock is known to have gone on and the target is the
        one that it was on its way to. Elsewhere none counts, so that nothing jumps. After a kill, the same map may have
        been served for long after its snapshot, so no more time counts than the way that was left takes.
        """
        for length_mm in snapshot.tool_lengths_mm or ():
            self._reach = self._reach.including(length_mm)
        served = snapshot.served
        if served is None:
            return
        if not self.settings.replay:
            now_s = self.steady()
            since_s = 0.0
            if snapshot.boot is not None and snapshot.boot == boot_id() and snapshot.model == self.bundle.version:
                since_s = max(now_s - served.time_s, 0.0)
                if not snapshot.last:
                    since_s = min(since_s, longest_way_s(served, self.machine.limits))
            served = replace(served, time_s=now_s - since_s)
        self.served = served

    def outlook(self, now_s: float) -> Outlook:
        """Return what is predicted for a moment."""
        if self.thermal is None:
            return Outlook(now_s, self._target, (Condition(Status.GEOMETRIC_ONLY, None),))
        weight, conditions = self.thermal.outlook(now_s, self.settings, self.telemetry_age_s(now_s))
        thermal = self.thermal.error_map()
        if thermal is not self._target.thermal or weight != self._target.weight:
            self._target = Target(self.bundle.geometry, thermal, weight)
        if not self._target.usable:
            sentence = "the predicted error terms are not usable numbers, so the last correction is held"
            conditions.append(Condition(Status.DEGRADED, sentence))
        conditions += self.monitor.conditions(self.bundle.version)
        return Outlook(now_s, self._target, tuple(conditions))

    def status(self, now_s: float) -> Status:
        """Return the status at a moment, without the error map: telemetry comes often and asks for no more."""
        if self.thermal is None:
            return Status.GEOMETRIC_ONLY
        _, conditions = self.thermal.outlook(now_s, self.settings, self.telemetry_age_s(now_s))
        return most_serious([*conditions, *self.monitor.conditions(self.bundle.version)])

    def telemetry_age_s(self, now_s: float) -> float | None:
        """Return how old the newest telemetry is; None before the first.

        By its own time, or since it came where that is longer: a clock that is set back makes nothing young.
        """
        if self.thermal is None or self.thermal.state is None:
            return None
        age_s = now_s - self.thermal.state.time_s
        if self.settings.replay:
            return max(age_s, 0.0)
        if self._came_s is None:  # before a restart; nobody knows when, where its time has not come yet
            unknown_s = self.settings.stale_after_s + self.settings.stale_fade_s
            self._came_s = self.steady() - (unknown_s if age_s < -MAX_AHEAD_S else 0.0)
        return max(age_s, self.steady() - self._came_s)

    def past(self) -> Past:
        """Return the present prediction, for the time when it is past; there must be one."""
        assert self.thermal is not None
        served = self.served is not None and not self.served.held and self.served.remaining_um <= ARRIVED_UM
        return Past.of(self.thermal, self._target.weight if served else None)

    def hand_out(self, tool_length_mm: float | None, now_s: float) -> tuple[Outlook, Served]:
        """Hand out the error map that is served now, for a client that compensates by itself.

        It counts as served, as corrections do: otherwise it could run ahead of the rate limit.

        Parameters
        ----------
        tool_length_mm : the longest tool that it is used with; None is the machine's own
        """
        outlook, served = self._advanced(tool_length_mm, now_s)
        self._serve(served)
        conditions = outlook.conditions + self._on_the_way(served)
        self._tell(most_serious(conditions))
        return Outlook(self.now(now_s), outlook.target, conditions), served

    def hand_out_solver(self, tool_length_mm: float | None, now_s: float) -> tuple[Outlook, Served, Solver]:
        """Hand out what corrections are computed from now, for any number of positions; it counts as served."""
        outlook, served = self.hand_out(tool_length_mm, now_s)
        predicted = outlook.target.errors if outlook.target.usable else served.errors
        return outlook, served, self._solvers.of(served.errors, predicted, tool_length_mm)

    def compensate(self, q: Array, tool_length_mm: float | None, now_s: float) -> Correction:
        """Hand out corrections for positions q of shape (n, A) [mm], moving what is served towards the target."""
        outlook, served = self._advanced(tool_length_mm, now_s)
        predicted = outlook.target.errors if outlook.target.usable else served.errors
        solved = self._solvers.of(served.errors, predicted, tool_length_mm).solve(q)
        uncertainty_um = self.uncertainty_um(q, outlook, tool_length_mm)
        self._serve(served)
        self.counts.positions += len(q)
        conditions = outlook.conditions + self._on_the_way(served) + self._bounded(solved)
        at = Outlook(self.now(now_s), outlook.target, conditions)
        self._tell(at.status)
        limited = solved.clipped if served.arrived else np.ones(len(q), dtype=np.bool_)
        return Correction(
            at,
            solved.corrected,
            solved.correction_mm,
            solved.deviation_mm,
            limited,
            predicted,
            self._solvers.tool_mm(tool_length_mm),
            uncertainty_um,
        )

    def uncertainty_um(self, q: Array, outlook: Outlook, tool_length_mm: float | None) -> Array | None:
        """Return half the width of the 95 % interval of the deviation predicted at q (n, A), shape (n,) [µm].

        What the weight of the thermal part leaves out of the prediction is added. None where the bundle does not say
        how far predictions may be off, and where the thermal part does not count: then nobody knows how far it is off.
        """
        target, spread = outlook.target, None if self.thermal is None else self.thermal.spread()
        if self.interval is None or spread is None or target.thermal is None or not target.weight > 0.0:
            return None
        half_width = self.interval.half_width_um(q, tool_length_mm, spread)
        if target.weight < 1.0 and target.usable:
            tool_mm = None if tool_length_mm is None else tool_length_mm * np.asarray(self.machine.tool.direction)
            half_width = half_width + unapplied_um(self.chain, q, target.thermal, target.weight, tool_mm)
        return half_width if target.usable and np.isfinite(half_width).all() else None

    @cached_property
    def interval(self) -> Interval | None:
        """How far predictions may be off, by position; None where the bundle does not say."""
        if self.thermal is None or self.thermal.predictor.uncertainty is None:
            return None
        return Interval(self.thermal.predictor.uncertainty, self.chain)

    def largest_correction_um(self) -> float | None:
        """Return the largest correction over the working volume, as served last; None before anything was."""
        if self.served is None:
            return None
        return min(self._survey.largest_um(self.served.errors), self.machine.limits.max_correction_um)

    @property
    def reach(self) -> Reach:
        """How far error terms can move a correction, with the tools seen so far."""
        return self._reach

    def _serve(self, served: Served) -> None:
        self.served = served
        if self.recorder is not None:
            self.recorder.served(self)

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

    def _bounded(self, solved: Solved) -> tuple[Condition, ...]:
        """Return what the absolute limit did, and corrected coordinates that leave their axis' range."""
        if len(solved.clipped) == 1 and self._stays(solved):
            return ()
        low, high = self.machine.axis_ends
        leaves = (solved.corrected < low) | (solved.corrected > high)
        if not (np.logical_or.reduce(leaves, axis=None) or np.logical_or.reduce(solved.clipped)):
            return ()
        sentences: list[str] = []
        clipped = int(solved.clipped.sum())
        if clipped:
            most_um = self.machine.limits.max_correction_um
            sentences.append(f"{clipped} positions are limited to ±{most_um:g} µm on an axis")
        for column, name in enumerate(self.machine.axis_names):
            axis = self.machine.axes[name]
            leaving = int(leaves[:, column].sum())
            if leaving:
                sentences.append(
                    f"{leaving} corrected positions leave the range {axis.low:g} ... {axis.high:g} mm of axis '{name}'"
                )
        return tuple(Condition(Status.OK, s) for s in sentences)

    def _stays(self, solved: Solved) -> bool:
        """Return whether a single position is not clipped, and stays within the axes' ranges: nearly always."""
        corrected = zip(solved.corrected[0].tolist(), self._ranges, strict=True)
        return not solved.clipped[0] and all(low <= value <= high for value, (low, high) in corrected)

    @cached_property
    def _ranges(self) -> list[tuple[float, float]]:
        axes = [self.machine.axes[name] for name in self.machine.axis_names]
        return [(axis.low, axis.high) for axis in axes]

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
