"""Run a bundle's network with onnxruntime: temperatures in, thermal state and error terms out. No torch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from model.bundle import Bundle
from model.error_map import ErrorMap
from model.exceptions import BundleError, ComputeError
from model.fields import Fields
from model.lost_sensors import Mask, stepped_doubt
from model.onnx_scan import check_network_file
from model.parity import check_parity, one_line
from model.reliability import Missed, beyond_um, tip_rms_um
from model.replacement import Replacement
from model.sensors import SensorModel
from model.sessions import session_of
from model.telemetry import Run
from model.tip_effects import tip_form
from model.transforms import Array
from model.uncertainty import Uncertainty


@dataclass(frozen=True)
class ThermalState:
    """All that the network remembers between two samples.

    Attributes
    ----------
    time_s : of the last sample; any origin, seconds
    since_s : of the first sample, where the modes were taken to be in equilibrium
    inputs : that sample, temperatures [°C] and channels, shape (S + C,)
    modes : thermal modes, shape (M,)
    coefficients : of the fields [µm, µrad], shape (P,)
    first : temperatures at the first sample [°C], shape (S,)
    doubt : of each sensor's value and of its K modes, the share of the variance that is not known since the sensor was
        lost: 0 known, 1 estimated from the others alone, shape (S, 1 + K)
    unseen : 1 for sensors without a reading since the first sample of a network that knows only changes, shape (S,)
    shift : taken off each sensor's readings [°C], shape (S,): what it read first beyond its estimate, where it came
        after the first sample of such a network
    """

    time_s: float
    since_s: float
    inputs: Array
    modes: Array
    coefficients: Array
    first: Array
    doubt: Array
    unseen: Array
    shift: Array


class Predictor:
    """The network of one bundle.

    Attributes
    ----------
    record : what the manifest says of it
    sensors, channels : names of the inputs, in order
    sensor_model : estimates a sensor from the others
    uncertainty : how far predictions may be off, None where the bundle does not say

    Raises
    ------
    BundleError
        where the bundle has no network, or one that does not fit its manifest or does not compute here what it did
        when it was exported.
    """

    def __init__(self, bundle: Bundle) -> None:
        record = bundle.manifest.network
        if bundle.network is None or record is None:
            raise BundleError(f"bundle '{bundle.path}' has no network: it is geometric only")
        self.record = record
        self.sensors, self.channels = tuple(record.sensors), tuple(record.channels)
        self.settling_time_s = record.settling_time_s
        self.datum = record.datum
        self.sensor_model = SensorModel(np.array(record.sensor_mean_degC), np.array(record.sensor_covariance_K2))
        self.fields = Fields(bundle.machine, tuple(record.terms), record.degree)
        self._modes, self._tau_s = record.modes, np.array(record.time_constants_s)
        self.uncertainty = (
            None if record.uncertainty is None else Uncertainty(self.fields, record.uncertainty, record.modes)
        )
        check_network_file(bundle.network, f"bundle '{bundle.path}'")
        try:
            self._session = session_of(bundle.network)
        except Exception as problem:
            raise BundleError(f"bundle '{bundle.path}': network.onnx cannot be loaded: {one_line(problem)}") from None
        self._check_signature(bundle)
        check_parity(self._session, record, self.fields, f"bundle '{bundle.path}'")
        self._lost_record = record.lost_sensors
        self._replacement = None if record.lost_sensors is None else Replacement(record, self._batch, self._form)

    def start(self, time_s: float, temperatures: Array, channels: Array) -> ThermalState:
        """Return the state after a first sample, with the modes in equilibrium with it.

        Parameters
        ----------
        temperatures : shape (S,) [°C], NaN where a sensor has no reading: estimated from the others
        channels : shape (C,)
        """
        missing = ~np.isfinite(temperatures)
        inputs = np.concatenate([self.sensor_model.fill(temperatures), channels])
        modes, coefficients = self._run(inputs, inputs, np.zeros(self._modes), 0.0, fresh=True)
        first = inputs[: len(self.sensors)]
        doubt = np.zeros((len(self.sensors), 1 + len(self._tau_s)))
        shift = np.zeros(len(self.sensors))
        if self.datum == "run-start":  # changes since now are zero, whatever a sensor reads that is missing
            return ThermalState(time_s, time_s, inputs, modes, coefficients, first, doubt, 1.0 * missing, shift)
        if missing.any():
            doubt[missing] = 1.0
            if self._replacement is not None:
                inputs, modes = self._replacement.replaced(inputs, modes, missing, None, None)
                coefficients = self._run(inputs, inputs, modes, 0.0)[1]
        return ThermalState(time_s, time_s, inputs, modes, coefficients, first, doubt, shift, shift)

    def step(self, state: ThermalState, time_s: float, temperatures: Array, channels: Array) -> ThermalState:
        """Return the state after one more sample, as `start`; the time must not go back.

        Raises
        ------
        ComputeError
            where it does.
        """
        dt_s = time_s - state.time_s
        if dt_s < 0:
            raise ComputeError(f"samples must come in the order of time, got one {-dt_s:g} s before the last")
        absent = ~np.isfinite(temperatures)
        # Only changes count: what a sensor reads that was never there yet is as if it read what was estimated.
        arriving = (state.unseen > 0.0) & ~absent
        missing = absent | arriving
        readings = np.where(missing, np.nan, temperatures - state.shift)
        inputs = np.concatenate([self._stand_in(state, readings), channels])
        modes, coefficients = self._run(inputs, state.inputs, state.modes, dt_s)
        if missing.any() and self._replacement is not None:
            first = state.first if self.datum == "run-start" else None
            before = state.inputs, state.modes, dt_s
            inputs, modes = self._replacement.replaced(inputs, modes, missing, first, before)
            coefficients = self._run(inputs, inputs, modes, 0.0)[1]
        unseen, shift = state.unseen, state.shift
        if arriving.any():
            unseen = unseen * absent
            shift = np.where(arriving, temperatures - inputs[: len(absent)], shift)
        doubt = self._doubt(state, missing, dt_s)
        return ThermalState(time_s, state.since_s, inputs, modes, coefficients, state.first, doubt, unseen, shift)

    def _stand_in(self, state: ThermalState, readings: Array) -> Array:
        """Return readings (S,) with something in place of NaN: an estimate, where there is no better one to come."""
        missing = np.isnan(readings)
        if self._replacement is None and not missing.all():
            return self.sensor_model.fill(readings)
        # With nothing to estimate from, all stay as they were.
        return np.where(missing, state.inputs[: len(missing)], readings)

    def _doubt(self, state: ThermalState, missing: Mask, dt_s: float) -> Array:
        if not (missing.any() or state.doubt.any()):
            return state.doubt
        faded = np.concatenate([[0.0], np.exp(-dt_s / self._tau_s)])
        kept = faded if self._replacement is None else self._replacement.lost.kept(dt_s)
        stepped = stepped_doubt(state.doubt, missing, kept, faded)
        # Where a sensor's readings start is as doubtful as the estimate that it was put to, for good.
        return np.where(((state.shift != 0.0) & ~missing)[:, None], state.doubt, stepped)

    def follow(self, run: Run) -> Array:
        """Return the coefficients at every sample of a run, shape (T, K), from its first sample on.

        One step after another, as the service takes them.
        """
        return self.follow_states(run)[0]

    def follow_states(self, run: Run) -> tuple[Array, Array]:
        """Return the coefficients (T, P) and the thermal modes (T, M) at every sample of a run."""
        states = self.states(run)
        return np.array([s.coefficients for s in states]), np.array([s.modes for s in states])

    def states(self, run: Run) -> list[ThermalState]:
        """Return the state at every sample of a run, from its first sample on."""
        state = self.start(float(run.time_s[0]), run.temperatures[0], run.channels[0])
        states = [state]
        for i in range(1, len(run.time_s)):
            state = self.step(state, float(run.time_s[i]), run.temperatures[i], run.channels[i])
            states.append(state)
        return states

    def spread(self, states: Sequence[ThermalState]) -> Array:
        """Return how many times as far off as usual the prediction may be at each sample of a run, shape (T,).

        It is the size that `uncertainty` asks for, with what the estimates of lost sensors miss. The states are those
        of the run from its first sample on, since a network of run-start data knows only changes.

        Raises
        ------
        BundleError
            where the bundle does not say how far predictions may be off.
        """
        if self.uncertainty is None:
            raise BundleError("bundle must say how far predictions may be off, got no such record; train it again")
        modes = np.array([s.modes for s in states])
        size = self.uncertainty.size(modes, modes[0] if self.datum == "run-start" else None)
        return np.hypot(size, [self.lost_size(s) for s in states])

    def lost_size(self, state: ThermalState) -> float:
        """Return what the estimates of lost sensors miss at the tip, as a share of what usually is.

        Squares add up: `hypot(uncertainty.size(...), lost_size(state))` is the size of the uncertainty. 0 where no
        sensor is lost, and where the bundle does not say.
        """
        if self._replacement is None or not self._usual_um > 0.0:
            return 0.0
        return self._replacement.missed_um(state.doubt) / self._usual_um

    def missed(self, state: ThermalState) -> Missed | None:
        """Return what the prediction misses beyond the usual, which tells its reliability; None without a record.

        It grows with sensors that are lost, and outside of the thermal states that training saw; see
        `model/reliability.py`.
        """
        record = self._lost_record
        if self._replacement is None or record is None:
            return None
        start = None
        if self.datum == "run-start":
            inputs = np.concatenate([state.first, np.zeros(len(self.channels))])
            start, _ = self._run(inputs, inputs, np.zeros(self._modes), 0.0, fresh=True)
        beyond = 0.0
        if self.uncertainty is not None and self.uncertainty.largest_size is not None:
            size = float(self.uncertainty.size(state.modes, start))
            beyond = beyond_um(size, self.uncertainty.largest_size, self.uncertainty.directions, self._form)
        return Missed(record.drift_um, self._replacement.missed_um(state.doubt), beyond)

    def error_map(self, state: ThermalState) -> ErrorMap:
        """Return the thermal part of the error terms."""
        return self.fields.tabulate(state.coefficients)

    @cached_property
    def _form(self) -> Array:
        return tip_form(self.fields)

    @cached_property
    def _usual_um(self) -> float:
        """Root mean square at the tip of what is usually missed [µm], 0 where the bundle does not say."""
        return 0.0 if self.uncertainty is None else tip_rms_um(self.uncertainty.directions, self._form)

    def _run(
        self, inputs: Array, previous: Array, modes: Array, dt_s: float, *, fresh: bool = False
    ) -> tuple[Array, Array]:
        """Return modes and coefficients of one step; a step of no time leaves the modes as they are."""
        one = self._batch(inputs[None], previous[None], modes[None], np.array([[dt_s]]), np.array([[float(fresh)]]))
        return one[0][0], one[1][0]

    def _batch(self, inputs: Array, previous: Array, modes: Array, dt_s: Array, fresh: Array) -> tuple[Array, Array]:
        fed = {"inputs": inputs, "previous": previous, "modes": modes, "dt_s": dt_s, "fresh": fresh}
        stepped, coefficients = self._session.run(None, fed)
        if not (np.isfinite(stepped).all() and np.isfinite(coefficients).all()):
            raise ComputeError(f"the network must return finite numbers, got {coefficients[0]} for {inputs[0]}")
        return stepped, coefficients

    def _check_signature(self, bundle: Bundle) -> None:
        width = len(self.sensors) + len(self.channels)
        expected = {"inputs": width, "previous": width, "modes": self._modes, "dt_s": 1, "fresh": 1}
        found = {i.name: i.shape[1] for i in self._session.get_inputs() if len(i.shape) == 2}
        outputs = [o.shape[1] if len(o.shape) == 2 else None for o in self._session.get_outputs()]
        if found != expected or outputs != [self._modes, self.fields.size]:
            raise BundleError(
                f"bundle '{bundle.path}': network.onnx must take {expected} and return "
                f"{[self._modes, self.fields.size]}, got {found} and {outputs}; export it again"
            )
