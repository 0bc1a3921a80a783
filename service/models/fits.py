"""Whether an uploaded bundle is one of the machine that is served.

Whoever starts the service says what the machine is; an upload may bring a better model of it and may make the service
more careful, and never less so. What may differ: the network, the table of geometric errors, and in the machine's
description the rate of correction (slower) and the sensors' plausible ranges and rates (narrower).
"""

from __future__ import annotations

from dataclasses import dataclass

from model.bundle import Bundle
from model.exceptions import BundleError
from model.machine import Machine, Sensor


@dataclass(frozen=True)
class Installed:
    """What the service was started with, for one machine.

    Attributes
    ----------
    version : of the bundle on the command line
    channels : inputs of its network besides temperatures; None where it has no network
    """

    machine: Machine
    version: str
    channels: frozenset[str] | None

    @classmethod
    def of(cls, bundle: Bundle) -> Installed:
        """Return it for a bundle on the command line."""
        network = bundle.manifest.network
        return cls(bundle.machine, bundle.version, None if network is None else frozenset(network.channels))


def check_fits(installed: Installed, bundle: Bundle) -> None:
    """Check that a bundle is of the machine that the service was started with.

    Raises
    ------
    BundleError
        naming the first thing that differs and must not.
    """
    mine, given, where = installed.machine, bundle.machine, f"bundle '{bundle.path}'"
    if given.name != mine.name:
        raise BundleError(f"{where} must be of machine '{mine.name}', got one of '{given.name}'")
    for what in ("composition", "reference_temperature_degC", "layout", "axes", "tool", "workpiece"):
        if getattr(given, what) != getattr(mine, what):
            raise BundleError(
                f"{where}: the machine's '{what}' must be as served, got another; to change the machine itself, "
                "restart the service with a new bundle"
            )
    _check_limits(mine, given, where)
    if given.sensors.keys() != mine.sensors.keys():
        odd = sorted(given.sensors.keys() ^ mine.sensors.keys())[0]
        raise BundleError(f"{where} must have the machine's sensors, got a difference in '{odd}'")
    for name, sensor in given.sensors.items():
        if not _narrower(sensor, mine.sensors[name]):
            raise BundleError(f"{where}: the bounds of sensor '{name}' must be as served or narrower, got wider ones")
    network = bundle.manifest.network
    if network is None and installed.channels is not None:
        raise BundleError(f"{where} must have a network, as the bundle has that the service was started with, got none")
    if network is not None and installed.channels is not None and set(network.channels) != installed.channels:
        raise BundleError(
            f"{where}: the network must read the channels that the machine's gateway sends, "
            f"{', '.join(sorted(installed.channels)) or 'none'}, got {', '.join(network.channels) or 'none'}"
        )


def _check_limits(mine: Machine, given: Machine, where: str) -> None:
    # Not smaller either: a correction beyond the new limit would be cut off at once, and the machine would jump.
    if given.limits.max_correction_um != mine.limits.max_correction_um:
        raise BundleError(
            f"{where}: max_correction_um must be {mine.limits.max_correction_um:g} as served, got "
            f"{given.limits.max_correction_um:g}; restart the service with a new bundle to change it"
        )
    if given.limits.max_rate_um_per_min > mine.limits.max_rate_um_per_min:
        raise BundleError(
            f"{where}: max_rate_um_per_min must be at most {mine.limits.max_rate_um_per_min:g} as served, got "
            f"{given.limits.max_rate_um_per_min:g}"
        )


def _narrower(given: Sensor, mine: Sensor) -> bool:
    return (
        mine.range_degC[0] <= given.range_degC[0]
        and given.range_degC[1] <= mine.range_degC[1]
        and given.max_rate_degC_per_min <= mine.max_rate_degC_per_min
    )
