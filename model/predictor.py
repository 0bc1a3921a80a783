"""Run a bundle's network with onnxruntime: temperatures in, thermal state and error terms out. No torch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import onnxruntime

from model.bundle import Bundle
from model.error_map import ErrorMap
from model.exceptions import BundleError, ComputeError
from model.fields import Fields
from model.sensors import SensorModel
from model.telemetry import Run
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
    coefficients : of the fields [µm, µrad], shape (K,)
    """

    time_s: float
    since_s: float
    inputs: Array
    modes: Array
    coefficients: Array


class Predictor:
    """The network of one bundle.

    Attributes
    ----------
    sensors, channels : names of the inputs, in order
    sensor_model : estimates a sensor from the others
    uncertainty : how far predictions may be off, None where the bundle does not say

    Raises
    ------
    BundleError
        where the bundle has no network, or one that does not fit its manifest.
    """

    def __init__(self, bundle: Bundle) -> None:
        record = bundle.manifest.network
        if bundle.network is None or record is None:
            raise BundleError(f"bundle '{bundle.path}' has no network: it is geometric only")
        self.sensors, self.channels = tuple(record.sensors), tuple(record.channels)
        self.settling_time_s = record.settling_time_s
        self.datum = record.datum
        self.sensor_model = SensorModel(np.array(record.sensor_mean_degC), np.array(record.sensor_covariance_K2))
        self.fields = Fields(bundle.machine, tuple(record.terms), record.degree)
        self._modes = record.modes
        self.uncertainty = (
            None if record.uncertainty is None else Uncertainty(self.fields, record.uncertainty, record.modes)
        )
        options = onnxruntime.SessionOptions()
        # One sample is too small to share out; threads would only wait for each other.
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        try:
            self._session = onnxruntime.InferenceSession(bundle.network, options, ["CPUExecutionProvider"])
        except Exception as problem:
            raise BundleError(f"bundle '{bundle.path}': network.onnx cannot be loaded: {problem}") from None
        self._check_signature(bundle)

    def start(self, time_s: float, temperatures: Array, channels: Array) -> ThermalState:
        """Return the state after a first sample, with the modes in equilibrium with it.

        Parameters
        ----------
        temperatures : shape (S,) [°C], NaN where a sensor has no reading: estimated from the others
        channels : shape (C,)
        """
        inputs = self._inputs(temperatures, channels)
        return self._advance(time_s, time_s, inputs, inputs, np.zeros(self._modes), 0.0, fresh=True)

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
        inputs = self._inputs(temperatures, channels)
        return self._advance(time_s, state.since_s, inputs, state.inputs, state.modes, dt_s, fresh=False)

    def follow(self, run: Run) -> Array:
        """Return the coefficients at every sample of a run, shape (T, K), from its first sample on.

        One step after another, as the service takes them.
        """
        return self.follow_states(run)[0]

    def follow_states(self, run: Run) -> tuple[Array, Array]:
        """Return the coefficients (T, K) and the thermal modes (T, M) at every sample of a run."""
        temperatures = self.sensor_model.fill(run.temperatures)
        state = self.start(float(run.time_s[0]), temperatures[0], run.channels[0])
        coefficients, modes = np.empty((len(run.time_s), self.fields.size)), np.empty((len(run.time_s), self._modes))
        coefficients[0], modes[0] = state.coefficients, state.modes
        for i in range(1, len(run.time_s)):
            state = self.step(state, float(run.time_s[i]), temperatures[i], run.channels[i])
            coefficients[i], modes[i] = state.coefficients, state.modes
        return coefficients, modes

    def spread(self, modes: Array) -> Array:
        """Return how many times as far off as usual the prediction may be at each sample of a run, shape (T,).

        It is the size that `uncertainty` asks for. `modes` (T, M) are those of the run from its first
        sample on, since a network of run-start data knows only changes.

        Raises
        ------
        BundleError
            where the bundle does not say how far predictions may be off.
        """
        if self.uncertainty is None:
            raise BundleError("bundle must say how far predictions may be off, got no such record; train it again")
        return self.uncertainty.size(modes, modes[0] if self.datum == "run-start" else None)

    def error_map(self, state: ThermalState) -> ErrorMap:
        """Return the thermal part of the error terms."""
        return self.fields.tabulate(state.coefficients)

    def _inputs(self, temperatures: Array, channels: Array) -> Array:
        return np.concatenate([self.sensor_model.fill(temperatures), channels])

    def _advance(
        self,
        time_s: float,
        since_s: float,
        inputs: Array,
        previous: Array,
        modes: Array,
        dt_s: float,
        *,
        fresh: bool,
    ) -> ThermalState:
        stepped, coefficients = self._session.run(
            None,
            {
                "inputs": inputs[None],
                "previous": previous[None],
                "modes": modes[None],
                "dt_s": np.array([[dt_s]]),
                "fresh": np.array([[float(fresh)]]),
            },
        )
        if not (np.isfinite(stepped).all() and np.isfinite(coefficients).all()):
            raise ComputeError(f"the network must return finite numbers, got {coefficients[0]} for {inputs}")
        return ThermalState(time_s, since_s, inputs, stepped[0], coefficients[0])

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
