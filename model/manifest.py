"""The manifest: everything needed to use a bundle's network, and where it came from."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from model.validation import Strict

FORMAT_VERSION = 1
"""Raised when a bundle's files change their meaning."""


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
