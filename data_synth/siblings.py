"""Siblings of a machine: the same design with other constants, as no two machines of a series are the same.

Sibling 0 is the design itself. What lets data sets be pooled and a network be transferred stays: nodes, sensors, axes,
their ranges, speeds and feeds; so do catalogue sizes of bearings, the thermometers' class and the lines that rotary
axes turn about. Lengths change by one factor along each of x, y and z and materials by one each, so that what met still
meets and a uniform change of temperature still turns nothing. A symmetric drawing does not make a symmetric machine:
its halves differ in joints, films, friction and sections.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

from data_synth.angle import Encoder, Worm
from data_synth.beam import Beam, Section
from data_synth.capability import Capability
from data_synth.design import Design
from data_synth.fields import SpeedShift
from data_synth.geometric import Workmanship
from data_synth.heat import (
    AccelerationSource,
    BearingFriction,
    FeedSource,
    PowerLaw,
    SpindleSource,
    SpindleStartSource,
    StandingSource,
    StrokeSource,
)
from data_synth.joints import Carriage, Connection, RotaryJoint
from data_synth.network import Film, Link, Network
from data_synth.race import Race
from data_synth.scale import Scale
from data_synth.screw import Screw
from data_synth.sensors import Thermometer
from data_synth.spindle import Spindle
from data_synth.supports import Foot
from data_synth.variation import (
    BESIDE,
    FURTHEST,
    SPREADS,
    Lot,
    Rule,
    conductance,
    coordinate,
    coordinates,
    each,
    factor,
    held,
    kept,
    melt,
    phase,
    place,
    point,
    sections,
    shares,
    together,
)
from model.exceptions import InputError

RULES: Mapping[type, Mapping[str, Rule]] = {
    # Heat stored and carried
    Network: {"capacities": each("masses")},
    Link: {"W_per_K": conductance},
    Film: {
        "still": kept,
        "spindle": factor("films"),
        "coolant": factor("films"),
        "door": factor("films"),
        "moving": factor("films"),
    },
    # Heat made
    BearingFriction: {
        "number": kept,
        "mean_diameter_mm": kept,
        "lubrication": factor("heat"),
        "viscosity_mm2_per_s": factor("heat"),
        "load_torque_N_mm": factor("heat"),
    },
    PowerLaw: {"W": factor("heat"), "at_speed": kept, "exponent": factor("exponents")},
    SpindleSource: {"onto": shares, "load_sensitivity": factor("heat")},
    SpindleStartSource: {"onto": shares, "inertia_kg_m2": factor("drives"), "lost": factor("heat")},
    StandingSource: {
        "onto": shares,
        "always_W": factor("heat"),
        "coolant_W": factor("heat"),
        "load_W": factor("heat"),
    },
    FeedSource: {"onto": shares},
    StrokeSource: {"share": kept},  # the rest of it is a feed source's
    AccelerationSource: {
        "onto": shares,
        "moved": factor("masses"),
        "acceleration": factor("drives"),
        "per_ampere": factor("drives"),
        "ohm": factor("drives"),
        "rapid_per_min": kept,
    },
    # What grows and bends
    Beam: {"origin_mm": point, "along": kept, "sections": sections, "expansion_per_K": melt},
    Section: {"at_mm": kept, "nodes": kept},  # see Beam
    Foot: {"at_mm": point, "hold": kept},
    Carriage: {"at_mm": point, "hold": kept},
    Connection: {"foot_mm": point, "top_mm": point},
    RotaryJoint: {"bearings": kept, "growth": together("sections")},  # bearings stay on their line
    Race: {
        "diameter_mm": kept,
        "turning": shares,
        "standing": shares,
        "phase_degree": phase,
        "share": factor("roundness"),
    },
    Screw: {
        "along": kept,
        "nut_at_zero_mm": coordinate,
        "nut_sign": kept,
        "fixed_mm": coordinate,
        "far_mm": coordinate,
        "edges_mm": coordinates,
        "expansion_per_K": melt,
        "held": held,
        "stretch_K": factor("preload"),
        "line_mm": point,
    },
    Scale: {
        "along": kept,
        "reader_at_zero_mm": coordinate,
        "reader_sign": kept,
        "fixed_mm": coordinate,
        "edges_mm": coordinates,
        "expansion_per_K": melt,
        "line_mm": point,
    },
    Encoder: {"disc_mm": point, "radius_mm": kept, "tangent": kept},
    Worm: {
        "disc_mm": point,
        "radius_mm": kept,
        "tangent": kept,
        "wheel": shares,
        "housing": shares,
        "centre_mm": kept,
    },
    Spindle: {"growth": each("sections"), "expansion_per_K": melt},
    SpeedShift: {"um": factor("heat"), "at_rpm": kept},
    # What measures, and what a programme may ask
    Thermometer: {
        "at": place,
        "lag_s": factor("lags"),
        "noise_K": kept,
        "step_K": kept,
        "offset_K": kept,
        "gain": kept,
        "drift_K": kept,
    },
    Capability: {"top_rpm": kept, "top_feed_per_min": kept, "strokes": kept},
    Workmanship: {
        **{
            f"{what}_um": factor("workmanship")
            for what in ("positioning", "straightness", "pitch", "location", "axial")
        },
        "radial_um": factor("workmanship"),
        **{f"{what}_urad": factor("workmanship") for what in ("roll", "squareness", "angle", "tilt")},
        "pitch_mm": kept,
        "secondary": kept,
        "points": kept,
        "step_degree": kept,
    },
    Design: {"layering": kept},
}
"""Which constant varies by which rule. A number without a rule stays as it is; `unruled` finds such."""

MARK = "~"
MOST = 999_999


def sibling(design: Design, number: int) -> Design:
    """Return the sibling of that number, a function of the design and the number alone; 0 is the design itself."""
    if not 0 <= number <= MOST:
        raise InputError(f"the number of a sibling of '{design.name}' must be from 0 to {MOST}, got {number}")
    if number == 0:
        return design
    varied: Design = _varied(Lot(design.name, number, design.network), "design", design, {})
    return replace(varied, name=sibling_name(design.name, number))


def sibling_name(base: str, number: int) -> str:
    """Return the name of a machine's sibling: its own machine for data sets, bundles and the service."""
    return f"{base}-{number}" if number else base


def parse(written: str, known: Mapping[str, Design]) -> tuple[str, int] | None:
    """Return the design's name and the sibling's number that `vmc3`, `vmc3~3` or `vmc3-3` names; None for no design.

    Raises
    ------
    InputError
        where a design's name is followed by what is no number of a sibling.
    """
    if written in known:
        return written, 0
    base, mark, number = written.partition(MARK)
    if not mark:
        base, mark, number = written.rpartition("-")
        if not re.fullmatch(r"[1-9]\d*", number):
            return None
    if not mark or base not in known:
        return None
    if not re.fullmatch(r"\d+", number) or int(number) > MOST:
        raise InputError(
            f"the number of a sibling of '{base}' must be from 0 to {MOST}, got '{number}'; write {base}{MARK}3"
        )
    return base, int(number)


def renamed(text: str, name: str) -> str:
    """Return a machine description under another name."""
    return re.sub(r'^name = "[^"]*"', f'name = "{name}"', text, count=1, flags=re.MULTILINE)


def described(base: str, number: int) -> str:
    """Return what a data card says of a sibling."""
    spreads = ", ".join(f"{kind} {100 * spread:g} %" for kind, spread in SPREADS.items())
    return (
        f"Sibling {number} of {base}: the same design, its constants times log-normal factors of these spreads "
        f"(never beyond {FURTHEST:g} of them): {spreads}. A thermometer takes up to {100 * BESIDE:g} % of its reading "
        "from a part beside its own. The constants on this page are the sibling's."
    )


def unruled(design: Design) -> set[str]:
    """Return the numbers of a design that no rule mentions, as Type.field."""
    return {
        f"{type(owner).__name__}.{name}"
        for owner, name, value in _constants(design)
        if name not in RULES.get(type(owner), {}) and _holds_numbers(value)
    }


def _varied(lot: Lot, key: str, value: Any, made: dict[int, Any]) -> Any:
    """Return a design's part with its constants varied; what two parts share, such as a screw, they go on sharing."""
    if id(value) in made:
        return made[id(value)]
    if is_dataclass(value) and not isinstance(value, type):
        rules = RULES.get(type(value), {})
        varied: Any = type(value)(
            **{
                name: rules[name](lot, f"{key}.{name}", one, value)
                if name in rules
                else _varied(lot, f"{key}.{name}", one, made)
                for name, one in _public(value)
            }
        )
        made[id(value)] = varied
        return varied
    if isinstance(value, Mapping):
        return {name: _varied(lot, f"{key}.{name}", one, made) for name, one in value.items()}
    if isinstance(value, tuple):
        return tuple(_varied(lot, f"{key}.{k}", one, made) for k, one in enumerate(value))
    return value


def _public(value: Any) -> list[tuple[str, Any]]:
    return [(f.name, getattr(value, f.name)) for f in fields(value) if f.init and not f.name.startswith("_")]


def _constants(value: Any) -> Iterator[tuple[Any, str, Any]]:
    """Give every field of every part of a design, with its owner."""
    if is_dataclass(value):
        for name, one in _public(value):
            yield value, name, one
            yield from _constants(one)
    elif isinstance(value, Mapping | tuple):
        for one in value.values() if isinstance(value, Mapping) else value:
            yield from _constants(one)


def _holds_numbers(value: Any) -> bool:
    if isinstance(value, Mapping | tuple):
        return any(_holds_numbers(one) for one in (value.values() if isinstance(value, Mapping) else value))
    return isinstance(value, int | float) and not isinstance(value, bool)
