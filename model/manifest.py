"""The manifest: everything needed to use a bundle's network, and where it came from."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from model.validation import Strict

FORMAT_VERSION = 2
"""Raised when a bundle's files change their meaning."""


class UncertaintyRecord(Strict):
    """How far the network's predictions may be off, from parts of the training data that were left out in turn.

    The coefficients' covariance is `scale`² (floor + rise (|z|² - |S z|²)) Σ d d', z the modes times `mode_size`, S the
    `seen_directions`; see `model/uncertainty.py`.

    Attributes
    ----------
    directions : d, shape (R, P) [µm, µrad]
    mode_size : of each mode, shape (M,)
    seen_directions : S, shape (L, M)
    floor, rise : how the variance depends on the thermal state
    misfit_um : root mean square of what the series over the axes' positions leave of the measurements, at the tip
    scale : makes 1.96 standard deviations a 95 % interval
    quantile : of |residual| / standard deviation at the tip, 95 %, on what was left out, before `scale`
    parts, independent : how many parts were left out, and how many independent measurements they had
    data : what was left out
    largest_size : of the thermal states that were left out; None in bundles made before it was kept
    """

    directions: list[list[float]]
    mode_size: list[float]
    seen_directions: list[list[float]]
    floor: Annotated[float, Field(gt=0)]
    rise: Annotated[float, Field(ge=0)]
    misfit_um: Annotated[float, Field(ge=0)]
    scale: Annotated[float, Field(gt=0)]
    quantile: Annotated[float, Field(gt=0)]
    parts: Annotated[int, Field(ge=2)]
    independent: Annotated[float, Field(gt=0)]
    data: str
    largest_size: Annotated[float, Field(gt=0)] | None = None


class LostSensorRecord(Strict):
    """What the values and modes of a lost sensor are told by, and what is missed then; see `model/lost_sensors.py`.

    The F features are, sensor by sensor, its value and its modes, then the modes of the heat sources.

    Attributes
    ----------
    mean : of the features [°C; share of full load], shape (F,); of run-start data the changes since the start, zero
    swing_K : by which temperatures are divided
    factors : A, shape (R, F); the covariance of the scaled features is A'A + `noise`
    noise : variance of each scaled feature that it shares with no other
    memory_s : over which what the estimate misses fades, of the value and of each mode
    scale : of what the estimates miss, from parts of the training data that were left out in turn
    drift_um : root mean square of the tip's predicted drift in training, over the working volume
    """

    mean: list[float]
    swing_K: Annotated[float, Field(gt=0)]
    factors: list[list[float]]
    noise: Annotated[float, Field(gt=0)]
    memory_s: list[Annotated[float, Field(gt=0)]]
    scale: Annotated[float, Field(gt=0)]
    drift_um: Annotated[float, Field(ge=0)]


class ParityRecord(Strict):
    """A few steps of the network, as torch computed them when it was exported; see `model/parity.py`.

    Attributes
    ----------
    dt_s : time since the step before, 0 for the first, length T
    inputs : of each sensor [°C] and channel, length T
    coefficients : of each error term's series [µm, µrad], shape (T, its width)
    """

    dt_s: Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=1, max_length=1000)]
    inputs: dict[str, list[float]]
    coefficients: dict[str, list[list[float]]]


class NetworkRecord(Strict):
    """What the network's inputs and outputs mean.

    Attributes
    ----------
    sensors, channels : columns of the input, in order; temperatures [°C], then other numeric channels
    terms, degree : error terms whose coefficients the network returns, and the degree of their series
    modes : number of thermal modes, the state between two samples
    time_constants_s : of the modes
    datum : "absolute" (zero at the reference temperature) or "run-start" (only changes have a meaning)
    settling_time_s : how long telemetry must have run until the unknown state at its start hardly matters
    valid_range_degC : per sensor, the temperatures seen in training
    valid_range_channels : per channel, the values seen in training
    sensor_mean_degC, sensor_covariance_K2 : for estimating a sensor from the others
    opset, exporter : how the ONNX file was made
    parity : what the network must return wherever it runs
    uncertainty : how far predictions may be off; None where the training data could not be divided to find out, and in
        bundles made before there was such a record
    lost_sensors : how a lost sensor's share is estimated from all other inputs; None where only its temperature is,
        from the other temperatures of the moment
    """

    sensors: list[str]
    channels: list[str]
    terms: list[str]
    degree: Annotated[int, Field(ge=0)]
    modes: Annotated[int, Field(ge=1)]
    time_constants_s: list[float]
    datum: Literal["absolute", "run-start"]
    settling_time_s: Annotated[float, Field(ge=0)]
    valid_range_degC: dict[str, tuple[float, float]]
    valid_range_channels: dict[str, tuple[float, float]]
    sensor_mean_degC: list[float]
    sensor_covariance_K2: list[list[float]]
    opset: int
    exporter: str
    parity: ParityRecord
    uncertainty: UncertaintyRecord | None = None
    lost_sensors: LostSensorRecord | None = None


class Manifest(Strict):
    """Contents of `manifest.json`.

    Attributes
    ----------
    format_version : of the bundle
    digest : SHA-256 of the file with zeros in the digest's place: an edit or damage is noticed
    machine : the machine's name
    files : SHA-256 of every other file in the bundle
    network : None for a geometric-only machine
    training : data, runs, settings and seed that made the network
    test : residuals on the runs left out, beside the baselines
    """

    format_version: int
    digest: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    machine: str
    files: dict[str, str]
    network: NetworkRecord | None = None
    training: dict[str, Any] = Field(default_factory=dict)
    test: dict[str, Any] = Field(default_factory=dict)
