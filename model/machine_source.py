"""Find the machine that a command names: a TOML file, a bundle or data set folder, or a preset."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from model.bundle import machine_of
from model.exceptions import DataError
from model.machine import Machine, load_machine, preset
from model.transforms import Array


def machine_at(written: str | Path) -> Machine:
    """Return the machine of a TOML file or folder; where there is none, the preset of that name.

    Raises
    ------
    MachineError
        where there is neither; for a bare word the message lists the presets, for a path it names the file.
    BundleError
        where a bundle is damaged.
    """
    bare = re.fullmatch(r"[A-Za-z0-9_-]+", str(written)) is not None
    if bare and not Path(written).exists():
        return load_machine(preset(str(written)))
    return machine_of(written)


def tool_tip(machine: Machine, length_mm: float | None) -> Array | None:
    """Return the tip of a tool of that length in the tool frame, shape (3,) [mm]; None without a length.

    Raises
    ------
    DataError
        where the length is not a finite number.
    """
    if length_mm is None:
        return None
    if not np.isfinite(length_mm):
        raise DataError(f"--tool-length must be a finite number of mm, got {length_mm}")
    return length_mm * np.asarray(machine.tool.direction)
