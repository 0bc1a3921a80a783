"""Which machines the shop has a thermal design for."""

from __future__ import annotations

from pathlib import Path

from data_synth.design import Design
from data_synth.gantry3 import GANTRY3
from data_synth.hmc4 import HMC4
from data_synth.run import Shop
from data_synth.seed3 import SEED3
from data_synth.siblings import parse, renamed, sibling, sibling_name
from data_synth.trunnion5 import TRUNNION5
from data_synth.vmc3 import VMC3
from model.exceptions import InputError, MachineError
from model.machine import Machine, load_machine, parse_machine, preset

DESIGNS: dict[str, Design] = {design.name: design for design in (VMC3, SEED3, HMC4, TRUNNION5, GANTRY3)}


def open_shop(machine: str) -> Shop:
    """Return the machine of that name, or of that description, with its thermal design.

    A name may end in the number of a sibling: `vmc3~3` is the machine `vmc3-3`, under which its description, data sets
    and bundles then go; that spelling is accepted, too.

    Raises
    ------
    InputError
        where there is no design for it, or the description changes what the design rests on.
    """
    path = Path(machine)
    if path.suffix == ".toml" or path.exists():
        described = load_machine(path)
        base, number = _known(described.name)
    else:
        base, number = _known(machine)
        text = preset(base).read_text(encoding="utf-8")
        described = parse_machine(renamed(text, sibling_name(base, number)), f"machine '{machine}'")
    design = sibling(DESIGNS[base], number)
    _check(described, load_machine(preset(base)), design)
    return Shop.of(described, design)


def _known(name: str) -> tuple[str, int]:
    found = parse(name, DESIGNS)
    if found is None:
        raise _unknown(name)
    return found


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
