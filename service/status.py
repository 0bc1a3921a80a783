"""How far a machine's correction can be trusted just now, in one word and in sentences."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import NamedTuple


class Status(StrEnum):
    """States of a machine, from the least serious to the most."""

    OK = "ok"
    WARMING_UP = "warming_up"
    """Telemetry has not run long enough for the unknown thermal state at its start to be forgotten."""
    DRIFTING = "drifting"
    """Probed deviations leave the interval in which predictions should keep them: the machine is no longer the one that
    the network was trained on."""
    DEGRADED = "degraded"
    """A sensor was replaced by its estimate, a channel by its last value, or a computation by its last result."""
    EXTRAPOLATING = "extrapolating"
    """Temperatures are outside what the network was trained on."""
    STALE = "stale"
    """The last telemetry is too old; the thermal part fades out."""
    GEOMETRIC_ONLY = "geometric_only"
    """The bundle has no network, or no telemetry has come yet: only measured geometric errors are corrected."""


_RANK = {status: rank for rank, status in enumerate(Status)}


class Condition(NamedTuple):
    """One reason for a status, and the sentence that tells the user; None where the status says it all."""

    status: Status
    sentence: str | None


def most_serious(conditions: Iterable[Condition]) -> Status:
    """Return the most serious status among the conditions, `ok` where there are none."""
    return max([c.status for c in conditions], key=_RANK.__getitem__, default=Status.OK)
