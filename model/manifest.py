"""The manifest: everything needed to use a bundle's network, and where it came from."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from model.validation import Strict

FORMAT_VERSION = 1
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
    uncertainty : how far predictions may be off; None where the training data could not be divided to find out, and in
        bundles made before there was such a record
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
    uncertainty: UncertaintyRecord | None = None


class Manifest(Strict):
    """Contents of `manifest.json`.

    Attributes
    ----------
    format_version : of the bundle
    machine : the machine's name
    files : SHA-256 of every other file in the bundle
    network : None for a geometric-only machine
    training : data, runs, settings and seed that made the network
    test : residuals on the runs left out, beside the baselines
    """

    format_version: int
    machine: str
    files: dict[str, str]
    network: NetworkRecord | None = None
    training: dict[str, Any] = Field(default_factory=dict)
    test: dict[str, Any] = Field(default_factory=dict)
