"""Everything thermotrue raises on purpose.

    ThermotrueError
    ├── InputError          the user's mistake: exit code 2, HTTP 4xx
    │   ├── MachineError    a machine description
    │   ├── DataError       a data set, an error table, positions, telemetry
    │   └── BundleError     a bundle that is damaged or does not fit
    └── ComputeError        ours: exit code 1, HTTP 5xx

A message is one sentence, lower case, without a full stop: what must hold, what came, where, what to do.
"""

from __future__ import annotations


class ThermotrueError(Exception):
    """Root of the tree."""


class InputError(ThermotrueError, ValueError):
    """The input is wrong; the message says what would be right."""


class MachineError(InputError):
    """A machine description is wrong."""


class DataError(InputError):
    """A data set, error table, positions or telemetry file is wrong."""


class BundleError(InputError):
    """A bundle is damaged, incomplete or does not fit its machine."""


class ComputeError(ThermotrueError):
    """A computation did not reach what it promises; nothing was returned."""
