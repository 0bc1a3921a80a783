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
from model.terms import UM
from model.transforms import Array
from service.guard import Track, judge
from service.reliability import beyond, freshness_weight, range_weight, replacement_weight
from service.safety import LARGEST_TERM
from service.schemas import Sample
from service.settings import Settings
from service.status import Condition, Status
from service.timestamps import format_time

log = logging.getLogger(__name__)

HOLD_S = 600.0
"""How long a channel that is no longer given keeps its last value [s]: a few lost samples (chosen)."""
PLAUSIBLE_CHANNEL = 2.0
"""How many times its largest value in training a channel may be (chosen: a faster spindle than any seen, but not a
value in other units)."""

DatumKind = Literal["absolute", "run-start", "set"]


@dataclass(frozen=True)
class Zero:
    """The datum in force; `errors` is None where nothing is subtracted."""

    kind: DatumKind
    errors: ErrorMap | None = None
    time_s: float | None = None


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

    def take(self, sample: Sample) -> bool:
        """Advance the state by a sample; False where it is no newer than the state or cannot be used.

        It cannot be used where the network fails on it, or where there is no state yet and so few plausible
        readings that the state would start from a guess.
        """
        if self.state is not None and sample.time <= self.state.time_s:
            return False
        verdict = judge(self.sensors, self.tracks, sample.time, sample.temperatures, self.predictor.sensor_model)
        self._tell(verdict.faults)
        self.tracks, self.faults = verdict.tracks, verdict.faults
        channels = self._heard(sample)
        readings = verdict.readings
        if self.state is None and self.replacement_weight() == 0.0:
            self.failure = f"{len(self.faults)} of {len(self.sensors)} sensors have no plausible reading to start from"
            return False
        if self.state is not None and len(self.faults) == len(self.sensors):
            readings = self.state.inputs[: len(readings)]  # nothing to estimate from: all stay as they were
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
            self.zero = self._run_start = Zero("run-start", self._map(state), sample.time)
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

    def set_datum(self) -> bool:
        """Make the present state the zero; False before the first sample."""
        if self.state is None:
            return False
        self.zero, self._relative = Zero("set", self._map(self.state), self.state.time_s), None
        return True

    def clear_datum(self) -> None:
        """Go back to the network's own datum: absolute, or the first sample where only changes have a meaning."""
        self.zero, self._relative = self._run_start, None

    def outlook(self, now_s: float, settings: Settings) -> tuple[float, list[Condition]]:
        """Return the weight of the thermal part, 0 ... 1, and every reason not to trust it fully."""
        if self.state is None:
            missing = "no telemetry has come yet, so only geometric errors are corrected; post telemetry"
            return 0.0, [Condition(Status.GEOMETRIC_ONLY, missing), *self._failed()]
        age_s = max(now_s - self.state.time_s, 0.0)
        weight = freshness_weight(age_s, settings.stale_after_s, settings.stale_fade_s)
        conditions: list[Condition] = []
        if weight < 1.0:
            conditions.append(
                Condition(
                    Status.STALE,
                    f"the newest telemetry is of {format_time(self.state.time_s)}, {age_s / 60:.0f} min ago; "
                    f"the thermal part counts {weight:.0%}",
                )
            )
        excursion, outside = self._excursion()
        weight *= excursion * self.replacement_weight()
        conditions += outside + self._replaced() + self._failed()
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

    def replacement_weight(self) -> float:
        """Return the weight that the share of replaced sensors leaves to the thermal part."""
        return replacement_weight(len(self.faults), len(self.sensors))

    def _map(self, state: ThermalState) -> ErrorMap:
        if self._absolute is None:
            self._absolute = self.predictor.error_map(state)
        return self._absolute

    def _excursion(self) -> tuple[float, list[Condition]]:
        """Return the least weight of any sensor's distance from its trained range, and a sentence for each."""
        assert self.state is not None
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
        return weight, conditions

    def _replaced(self) -> list[Condition]:
        assert self.state is not None
        values = dict(zip(self.sensors, self.state.inputs, strict=False))
        conditions = [
            Condition(Status.DEGRADED, f"sensor '{n}' {fault}; replaced by its estimate {values[n]:.1f} °C")
            for n, fault in self.faults.items()
        ]
        return conditions + [Condition(Status.DEGRADED, f"channel '{name}' {why}") for name, why in self.held.items()]

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
