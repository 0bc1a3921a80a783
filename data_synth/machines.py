"""Which machines the shop has a thermal design for."""

from __future__ import annotations

from pathlib import Path

from data_synth.design import Design
from data_synth.run import Shop
from data_synth.vmc3 import VMC3
from model.exceptions import InputError, MachineError
from model.machine import Machine, load_machine, preset

DESIGNS: dict[str, Design] = {design.name: design for design in (VMC3,)}


def open_shop(machine: str) -> Shop:
    """Return the machine of that name, or of that description, with its thermal design.

    Raises
    ------
    InputError
        where there is no design for it, or the description changes what the design rests on.
    """
    path = Path(machine)
    if path.suffix != ".toml" and not path.exists():
        if machine not in DESIGNS:
            raise _unknown(machine)
        path = preset(machine)
    described = load_machine(path)
    if described.name not in DESIGNS:
        raise _unknown(described.name)
    design = DESIGNS[described.name]
    _check(described, load_machine(preset(described.name)), design)
    return Shop.of(described, design)


def _unknown(name: str) -> InputError:
    return InputError(f"machine '{name}' must have a thermal design to be simulated; the shop has {', '.join(DESIGNS)}")


def _check(described: Machine, known: Machine, design: Design) -> None:
    for what in ("composition", "bodies", "axes"):
        if getattr(described, what) != getattr(known, what):
            raise MachineError(
                f"machine '{described.name}' must have the {what} of its preset, on which its design rests; "
                "give a machine of another make its own name"
            )
    for sensor in described.sensors:
        if sensor not in design.thermometers:
            raise MachineError(
                f"sensor '{sensor}' of machine '{described.name}' must be one its thermal design has: "
                f"{', '.join(design.thermometers)}"
            )
    if not described.sensors:
        raise MachineError(f"machine '{described.name}' must describe its sensors ([sensors.NAME]), got none")
