"""A machine's thermal state: telemetry samples in, thermal error map out."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from model.error_map import ErrorMap
from model.exceptions import ComputeError
from model.machine import Machine
from model.manifest import NetworkRecord
from model.predictor import Predictor, ThermalState
from model.reliability import Missed
from model.terms import UM
from model.transforms import Array
from service.agreement import Agreement
from service.guard import Track, judge
from service.reliability import beyond, freshness_weight, range_weight, replacement_weight
from service.safety import LARGEST_TERM
from service.schemas import Sample
from service.settings import Settings
from service.status import Condition, Status
from service.timestamps import format_time
from service.uncertainty import relative_spread

log = logging.getLogger(__name__)

MAX_AHEAD_S = 60.0
"""How far a time may be ahead of the service's clock [s]: two clocks that somebody sets differ by less, and one sample
of a wrong hour would make all later ones too old."""
HOLD_S = 600.0
"""How long a channel that is no longer given keeps its last value [s]: a few lost samples (chosen)."""
PLAUSIBLE_CHANNEL = 2.0
"""How many times its largest value in training a channel may be (chosen: a faster spindle than any seen, but not a
value in other units)."""
UNLIKE = 0.95
"""Weight below which a thermal state is said to be unlike those of the training (chosen: new kinds of runs differ a
little from all others)."""

DatumKind = Literal["absolute", "run-start", "set"]


@dataclass(frozen=True)
class Zero:
    """The datum in force; `errors` is None where nothing is subtracted, `modes` (M,) where they are not known."""

    kind: DatumKind
    errors: ErrorMap | None = None
    time_s: float | None = None
    modes: Array | None = None


@dataclass(frozen=True)
class Memory:
    """All that a machine's thermal part remembers: with it another process goes on exactly where this one was.

    Attributes
    ----------
    state : of the network, None before the first sample
    tracks, faults, held, failure : what the guard remembers and found in the newest sample
    channels : the values in use, in the network's order
    heard_s : when each channel was last given
    run_start, zero : what `clear_datum` returns to, and the datum in force
    """

    state: ThermalState | None
    tracks: Mapping[str, Track]
    faults: Mapping[str, str]
    held: Mapping[str, str]
    failure: str | None
    channels: Array
    heard_s: Mapping[str, float]
    run_start: Zero
    zero: Zero


class Thermal:
    """The network of one machine, its state, its inputs' health and its datum.

    Parameters
    ----------
    predictor, record : the network and what its manifest says of it
    machine : gives the sensors' plausible ranges
    """

    def __init__(self, predictor: Predictor, record: NetworkRecord, machine: Machine) -> None:
        self.predictor = predictor
        self.record = record
        self.sensors = {name: machine.sensors[name] for name in predictor.sensors}
        self._agreement = Agreement(predictor.sensor_model)
        self.state: ThermalState | None = None
        self.tracks: Mapping[str, Track] = {}
        self.faults: Mapping[str, str] = {}
        self.held: Mapping[str, str] = {}
        self.failure: str | None = None
        self._channels = np.zeros(len(predictor.channels))
        self._heard_s: dict[str, float] = {}
        self._run_start = Zero("run-start" if record.datum == "run-start" else "absolute")
        self.zero = self._run_start
        self._absolute: ErrorMap | None = None
        self._relative: ErrorMap | None = None
        self._spread: tuple[ThermalState, Zero, float | None] | None = None
        self._missed: tuple[ThermalState, Missed | None] | None = None
        self._told: tuple[tuple[object, ...], list[Condition]] | None = None
        self._excursed: tuple[ThermalState, float, list[Condition]] | None = None

    def take(self, sample: Sample) -> bool:
        """Advance the state by a sample; False where it is no newer than the state or cannot be used.

        It cannot be used where the network fails on it, or where there is no state yet and so few plausible
        readings that the state would start from a guess.
        """
        if self.state is not None and sample.time <= self.state.time_s:
            return False
        verdict = judge(self.sensors, self.tracks, sample.time, sample.temperatures, self._agreement)
        self._tell(verdict.faults)
        self.tracks, self.faults = verdict.tracks, verdict.faults
        channels = self._heard(sample)
        readings = verdict.carried
        if self.state is None and replacement_weight(len(self.faults), len(self.sensors)) == 0.0:
            self.failure = f"{len(self.faults)} of {len(self.sensors)} sensors have no plausible reading to start from"
            return False
        try:
            if self.state is None:
                state = self.predictor.start(sample.time, readings, channels)
            else:
                state = self.predictor.step(self.state, sample.time, readings, channels)
        except ComputeError as problem:
            self.failure = str(problem)
            log.error("network failed", extra={"reason": self.failure})
            return False
        # A series is nowhere larger than the sum of its coefficients; the map itself is built once a request.
        if not np.abs(state.coefficients).sum() * UM < LARGEST_TERM:
            self.failure = "the error terms predicted from it are beyond any machine's"
            log.error("prediction not usable", extra={"reason": self.failure})
            return False
        first = self.state is None
        self.state, self.failure, self._channels = state, None, channels
        self._absolute = self._relative = None
        if first and self._run_start.kind == "run-start":
            self.zero = self._run_start = Zero("run-start", self._map(state), sample.time, state.modes)
        return True

    def _heard(self, sample: Sample) -> Array:
        """Return the channels to use, shape (C,): a missing or implausible one keeps its last value for a while.

        After `HOLD_S` it counts as zero, as one that was never given does: a spindle that is taken to run for hours
        when it stands is worse than one that is not heard of (bench/missing_channels.py).
        """
        channels = np.zeros(len(self.predictor.channels))
        held: dict[str, str] = {}
        for i, name in enumerate(self.predictor.channels):
            value = sample.channels.get(name)
            low, high = self.record.valid_range_channels[name]
            most = PLAUSIBLE_CHANNEL * max(abs(low), abs(high))
            if value is not None and abs(value) <= most:
                channels[i], self._heard_s[name] = value, sample.time
                continue
            why = "has no value" if value is None else f"is {value:g}, beyond the plausible ±{most:g}"
            if sample.time - self._heard_s.get(name, -math.inf) <= HOLD_S:
                channels[i] = self._channels[i]
            held[name] = f"{why}; taken as {channels[i]:g}"
        self.held = held
        return channels

    def error_map(self) -> ErrorMap | None:
        """Return the thermal part, relative to the datum; None before the first sample."""
        if self.state is None:
            return None
        if self._relative is None:
            zero = self.zero.errors
            self._relative = self._map(self.state) if zero is None else self._map(self.state) - zero
        return self._relative

    def spread(self) -> float | None:
        """Return how many times as far off as usual the prediction may be now, relative to the datum.

        None before the first sample, and where the bundle does not say how far predictions may be off.
        """
        if self.state is None:
            return None
        if self._spread is None or self._spread[0] is not self.state or self._spread[1] is not self.zero:
            now, datum = self.spread_now(), self.spread_of(self.zero)
            self._spread = self.state, self.zero, None if now is None or datum is None else relative_spread(now, datum)
        return self._spread[2]

    def spread_now(self) -> float | None:
        """Return the part of `spread` that comes from the present state."""
        uncertainty, zero = self.predictor.uncertainty, self.zero
        if self.state is None or uncertainty is None:
            return None
        if self.record.datum == "run-start" and zero.modes is None:
            return None
        since = zero.modes if self.record.datum == "run-start" else None  # such a network knows only changes
        return math.hypot(float(uncertainty.size(self.state.modes, since)), self.predictor.lost_size(self.state))

    def spread_of(self, zero: Zero) -> float | None:
        """Return the part that comes from a datum; 0 for a network of changes, where the present state has it all."""
        if zero.kind == "absolute" or self.record.datum == "run-start":
            return 0.0
        uncertainty = self.predictor.uncertainty
        return None if uncertainty is None or zero.modes is None else float(uncertainty.size(zero.modes))

    def set_datum(self) -> bool:
        """Make the present state the zero; False before the first sample."""
        zero = self.moment("set")
        if zero is None:
            return False
        self.put_zeros(self._run_start, zero)
        return True

    def clear_datum(self) -> None:
        """Go back to the network's own datum: absolute, or the first sample where only changes have a meaning."""
        self.put_zeros(self._run_start, self._run_start)

    def memory(self) -> Memory:
        """Return all that is remembered; nothing in it is changed later."""
        return Memory(
            self.state,
            self.tracks,
            self.faults,
            self.held,
            self.failure,
            self._channels,
            dict(self._heard_s),
            self._run_start,
            self.zero,
        )

    def recall(self, memory: Memory) -> None:
        """Go on from what the same network remembered."""
        self.state, self.tracks, self.faults = memory.state, memory.tracks, memory.faults
        self.held, self.failure = memory.held, memory.failure
        self._channels, self._heard_s = memory.channels, dict(memory.heard_s)
        self.put_zeros(memory.run_start, memory.zero)
        self._absolute = None

    def put_zeros(self, run_start: Zero, zero: Zero) -> None:
        """Set what `clear_datum` returns to, and the datum in force."""
        self._run_start, self.zero, self._relative = run_start, zero, None

    def moment(self, kind: DatumKind) -> Zero | None:
        """Return the present state as a datum; None before the first sample."""
        if self.state is None:
            return None
        return Zero(kind, self._map(self.state), self.state.time_s, self.state.modes)

    def outlook(self, now_s: float, settings: Settings, age_s: float | None = None) -> tuple[float, list[Condition]]:
        """Return the weight of the thermal part, 0 ... 1, and every reason not to trust it fully.

        Parameters
        ----------
        age_s : of the newest telemetry; None is by its own time alone
        """
        if self.state is None:
            missing = "no telemetry has come yet, so only geometric errors are corrected; post telemetry"
            return 0.0, [Condition(Status.GEOMETRIC_ONLY, missing), *self._failed()]
        age_s = max(now_s - self.state.time_s, 0.0) if age_s is None else age_s
        weight = freshness_weight(age_s, settings.stale_after_s, settings.stale_fade_s)
        conditions: list[Condition] = []
        if not settings.replay and self.state.time_s > now_s + MAX_AHEAD_S:
            conditions.append(
                Condition(
                    Status.STALE,
                    f"the newest telemetry is of {format_time(self.state.time_s)}, which has not come yet: a clock was "
                    f"set back, and all samples until then are ignored; the thermal part counts {weight:.0%}",
                )
            )
        elif weight < 1.0:
            conditions.append(
                Condition(
                    Status.STALE,
                    f"the newest telemetry is of {format_time(self.state.time_s)}, {age_s / 60:.0f} min ago; "
                    f"the thermal part counts {weight:.0%}",
                )
            )
        excursion, outside = self._excursion()
        reliance, unlike = self._reliance()
        weight *= excursion * reliance
        conditions += outside + unlike + self._replaced() + self._failed()
        seen_s = self.state.time_s - self.state.since_s
        if seen_s < self.record.settling_time_s:
            conditions.append(
                Condition(
                    Status.WARMING_UP,
                    f"telemetry has run for {seen_s / 60:.0f} min; the thermal state at its start is forgotten "
                    f"after {self.record.settling_time_s / 60:.0f} min",
                )
            )
        return weight, conditions

    def _reliance(self) -> tuple[float, list[Condition]]:
        """Return the weight that lost sensors and the thermal state leave to the thermal part, and a sentence.

        Where most sensors are gone they have a common cause, which no estimate knows of, so nothing is left.
        """
        assert self.state is not None
        counted = replacement_weight(len(self.faults), len(self.sensors))
        if self._missed is None or self._missed[0] is not self.state:
            self._missed = self.state, self.predictor.missed(self.state)
        missed = self._missed[1]
        if missed is None:
            return counted, []
        conditions: list[Condition] = []
        if missed.of_state < UNLIKE:
            conditions.append(
                Condition(
                    Status.EXTRAPOLATING,
                    f"the thermal state is unlike those that the network was trained on; for that the thermal part "
                    f"counts {missed.of_state:.0%}",
                )
            )
        return (0.0 if counted == 0.0 else missed.reliability), conditions

    def _map(self, state: ThermalState) -> ErrorMap:
        if self._absolute is None:
            self._absolute = self.predictor.error_map(state)
        return self._absolute

    def _excursion(self) -> tuple[float, list[Condition]]:
        """Return the least weight of any sensor's distance from its trained range, and a sentence for each."""
        assert self.state is not None
        if self._excursed is not None and self._excursed[0] is self.state:
            return self._excursed[1], self._excursed[2]
        weight, conditions = 1.0, []
        for name, value in zip(self.sensors, self.state.inputs, strict=False):
            low, high = self.record.valid_range_degC[name]
            distance_K = beyond(float(value), low, high)
            if distance_K > 0.0:
                weight = min(weight, range_weight(distance_K, high - low))
                conditions.append(
                    Condition(
                        Status.EXTRAPOLATING,
                        f"sensor '{name}' is at {value:.1f} °C, outside the {low:g} ... {high:g} °C that the "
                        "network was trained on",
                    )
                )
        self._excursed = self.state, weight, conditions
        return weight, conditions

    def _replaced(self) -> list[Condition]:
        assert self.state is not None
        of = self.state, self.faults, self.held
        if self._told is not None and all(a is b for a, b in zip(self._told[0], of, strict=True)):
            return self._told[1]
        values = dict(zip(self.sensors, self.state.inputs, strict=False))
        conditions = [
            Condition(Status.DEGRADED, f"sensor '{n}' {fault}; replaced by its estimate {values[n]:.1f} °C")
            for n, fault in self.faults.items()
        ]
        conditions += [Condition(Status.DEGRADED, f"channel '{name}' {why}") for name, why in self.held.items()]
        self._told = of, conditions
        return conditions

    def _failed(self) -> list[Condition]:
        if self.failure is None:
            return []
        return [Condition(Status.DEGRADED, f"the newest sample was not used: {self.failure}")]

    def _tell(self, faults: Mapping[str, str]) -> None:
        """Log what changed; a fault that lasts is told once."""
        for name in faults.keys() - self.faults.keys():
            log.warning("sensor replaced", extra={"sensor": name, "reason": faults[name]})
        for name in self.faults.keys() - faults.keys():
            log.info("sensor back", extra={"sensor": name})
