"""What a manifest's record of a network must satisfy, beyond its schema, to fit the machine and itself."""

from __future__ import annotations

import numpy as np

from model.exceptions import BundleError
from model.fields import Fields
from model.machine import Machine
from model.manifest import NetworkRecord
from model.sensors import is_covariance

LARGEST = 1e9
"""Beyond this no number of a network's record is believed, whatever its unit (chosen)."""


def check_network(record: NetworkRecord, machine: Machine, where: str) -> None:
    """Check a record; `where` names the manifest in messages.

    Raises
    ------
    BundleError
        for the first thing that does not fit.
    """
    inputs, terms = [*record.sensors, *record.channels], [machine.term(name).name for name in record.terms]
    for what, names in (("input", inputs), ("error term", terms)):
        if not names or len(set(names)) < len(names):
            raise BundleError(f"{where} must name each {what} of the network once, got {', '.join(names) or 'none'}")
    for sensor in record.sensors:
        if sensor not in machine.sensors:
            raise BundleError(f"{where}: the network needs sensor '{sensor}', which the machine does not have")
    _check_ranges("valid_range_degC", record.valid_range_degC, record.sensors, where)
    _check_ranges("valid_range_channels", record.valid_range_channels, record.channels, where)
    _check_time_constants(record, where)
    count = len(record.sensors)
    shape = [len(row) for row in record.sensor_covariance_K2]
    if len(record.sensor_mean_degC) != count or shape != [count] * count:
        raise BundleError(f"{where}: sensor statistics must be those of its {count} sensors")
    if not is_covariance(np.array(record.sensor_covariance_K2)):
        raise BundleError(f"{where}: sensor_covariance_K2 must be symmetric and positive semidefinite")
    if np.abs([*record.sensor_mean_degC, *np.diag(record.sensor_covariance_K2)]).max(initial=0.0) > LARGEST:
        raise BundleError(f"{where}: sensor statistics must be those of temperatures, got numbers beyond {LARGEST:g}")
    if record.uncertainty is not None:
        uncertainty, size = record.uncertainty, Fields(machine, tuple(record.terms), record.degree).size
        _check_table("uncertainty.directions", uncertainty.directions, size, where)
        _check_table("uncertainty.mode_size", [uncertainty.mode_size], record.modes, where)
        _check_table("uncertainty.seen_directions", uncertainty.seen_directions, record.modes, where)
        scalars = [uncertainty.floor, uncertainty.rise, uncertainty.misfit_um, uncertainty.scale]
        _check_table("uncertainty", [scalars], len(scalars), where)
    if record.lost_sensors is not None:
        lost = record.lost_sensors
        _check_table("lost_sensors.factors", [lost.mean, *lost.factors], len(lost.mean), where)
        scalars = [lost.swing_K, lost.noise, lost.scale, lost.drift_um, *lost.memory_s]
        _check_table("lost_sensors", [scalars], len(scalars), where)


def _check_table(key: str, rows: list[list[float]], width: int, where: str) -> None:
    """Check that all rows have that many numbers, and none beyond belief."""
    odd = next((len(row) for row in rows if len(row) != width), None)
    if odd is not None:
        raise BundleError(f"{where}: each row of {key} must have {width} numbers, got {odd}; export it again")
    if any(abs(value) > LARGEST for row in rows for value in row):
        raise BundleError(f"{where}: {key} must have numbers of a network, got one beyond {LARGEST:g}")


def _check_ranges(key: str, ranges: dict[str, tuple[float, float]], names: list[str], where: str) -> None:
    if set(ranges) != set(names):
        odd = sorted(set(ranges) ^ set(names))[0]
        raise BundleError(f"{where}: {key} must have the range of each of the network's inputs and no other: '{odd}'")
    for name, (low, high) in ranges.items():
        if not -LARGEST <= low <= high <= LARGEST:
            raise BundleError(f"{where}: {key} of '{name}' must rise, got [{low:g}, {high:g}]")


def _check_time_constants(record: NetworkRecord, where: str) -> None:
    found = record.time_constants_s
    if not found or not all(0.0 < tau <= LARGEST for tau in found):
        raise BundleError(f"{where}: time_constants_s must be positive numbers of seconds, got {found}")
    if record.modes % len(found):
        raise BundleError(
            f"{where}: modes must be a multiple of the {len(found)} time constants, got {record.modes}; export it again"
        )
    if record.settling_time_s > LARGEST:
        raise BundleError(f"{where}: settling_time_s must be at most {LARGEST:g}, got {record.settling_time_s:g}")
