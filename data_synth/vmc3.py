"""Thermal design of `vmc3`: a C-frame machining centre of five tonnes, 12 000 rpm, screws of 40 mm.

Masses and areas are those of a machine of this class; they and all contact conductances, shares of heat and
losses in this file are chosen, not measured, so that parts settle as tests report: spindle within an hour or two,
column and bed over a shift. Films of air come from materials.py over the part's surface; conduction in walls and
screws is k A / L.
"""

from __future__ import annotations

from data_synth.cycles import Capability
from data_synth.design import Design
from data_synth.environment import BOUNDARIES
from data_synth.heat import (
    BearingFriction,
    FeedSource,
    PowerLaw,
    Source,
    SpindleSource,
    StandingSource,
    StrokeSource,
)
from data_synth.materials import (
    CAST_IRON,
    COOLANT_J_PER_KG_K,
    MOVING_FILM_W_PER_M2_K,
    STEEL,
    STILL_FILM_W_PER_M2_K,
    capacity,
    conductance,
)
from data_synth.network import Film, Link, Network
from data_synth.screw import Screw
from data_synth.sensors import Thermometer
from data_synth.vmc3_structure import SCREWS, STRUCTURE

SIDES = ("left", "right")
FEED = 10000.0  # mm/min at which the losses of an axis are given

IRON_KG = {
    **{f"head_rear_{side}": 120.0 for side in SIDES},
    "head_front_low": 100.0,
    **{f"head_front_{side}": 55.0 for side in SIDES},
    **{f"column_lower_{part}": 250.0 for part in (*SIDES, "rear")},
    **{f"column_upper_{part}": 220.0 for part in (*SIDES, "rear")},
    **{f"bed_{end}_{part}": 340.0 for end in ("front", "rear") for part in (*SIDES, "base")},
    **{f"saddle_{side}_{part}": 75.0 for side in SIDES for part in ("front", "rear", "base")},
    **{f"table_{side}": 190.0 for side in SIDES},
}
STEEL_KG = {
    "spindle_front": 16.0,
    "spindle_rear": 10.0,
    "spindle_shaft": 16.0,
    "motor": 60.0,
    **{f"motor_{axis}": 22.0 for axis in "xyz"},  # with coupling, fixed bearing and its housing
    **{f"nut_{axis}": 6.0 for axis in "xyz"},  # with its bracket
}
SCREW_KG_PER_M = 9.9  # a steel rod of 40 mm
SCREW_SECTION_M2 = 1.26e-3
SCREW_GIRTH_M = 0.126

FAN = Film(spindle=1.5)  # air stirred by what turns
SHAFT = Film(spindle=4.0)
SPLASH = Film(still=0.0, coolant=1.0)
DOOR = Film(door=3.0, coolant=0.3)
TURNING = Film(moving=MOVING_FILM_W_PER_M2_K / STILL_FILM_W_PER_M2_K - 1.0)


def air(node: str, to: str, area_m2: float, film: Film = Film()) -> Link:  # noqa: B008 (frozen)
    """Return the film of air over a surface."""
    return Link(node, to, STILL_FILM_W_PER_M2_K * area_m2, film)


def _head() -> list[Link]:
    links = [
        Link("spindle_front", "spindle_shaft", 7.0),
        Link("spindle_rear", "spindle_shaft", 5.0),
        Link("spindle_front", "head_front_low", 14.0),
        Link("spindle_front", "chiller", 18.0),
        Link("spindle_rear", "chiller", 12.0),
        air("spindle_front", "enclosure", 0.15, FAN),
        air("spindle_shaft", "enclosure", 0.10, SHAFT),
        Link("spindle_front", "coolant", 4.0, SPLASH),
        air("motor", "air_high", 1.0, FAN),  # ribs and a fan
        Link("head_front_left", "chiller", 3.0),  # its pipes run down the left side
        Link("head_front_left", "head_front_right", 5.0),
        Link("head_rear_left", "head_rear_right", 8.0),
        air("head_front_low", "enclosure", 0.5),
    ]
    for side in SIDES:
        rear, front = f"head_rear_{side}", f"head_front_{side}"
        links += [Link("spindle_rear", front, 5.0), Link("motor", front, 3.0), Link("head_front_low", front, 5.0)]
        links += [Link(rear, "head_front_low", 6.0), Link(rear, front, 6.0)]
        links += [air(front, "air_high", 0.25), air(rear, "air_high", 0.35)]
        links += [Link(rear, f"column_upper_{side}", 5.0), Link(rear, f"column_lower_{side}", 3.0)]
    return links


def _column() -> list[Link]:
    links = []
    wall = conductance(CAST_IRON, 0.015, 0.7)
    for part in (*SIDES, "rear"):
        links.append(Link(f"column_lower_{part}", f"column_upper_{part}", wall))
    for level, high in (("lower", 0.0), ("upper", 1.0)):
        rear = f"column_{level}_rear"
        links += [Link(f"column_{level}_left", f"column_{level}_right", 1.8)]
        for side in SIDES:
            here, low_air = f"column_{level}_{side}", f"air_{side}"
            links += [Link(here, rear, 2.5), air(here, "air_high" if high else low_air, 0.8)]
            links += [air(here, "enclosure", 0.2), air(rear, "air_high" if high else low_air, 0.35)]
            if not high:
                links.append(Link(here, f"bed_rear_{side}", 5.0))
    return [*links, Link("column_lower_rear", "bed_rear_base", 3.0)]


def _bed() -> list[Link]:
    links = []
    for part in (*SIDES, "base"):
        links.append(Link(f"bed_front_{part}", f"bed_rear_{part}", conductance(CAST_IRON, 0.03, 0.9)))
    for end in ("front", "rear"):
        base = f"bed_{end}_base"
        links += [Link(f"bed_{end}_left", f"bed_{end}_right", 3.0), Link(base, "floor", 6.0)]
        for side in SIDES:
            here = f"bed_{end}_{side}"
            links += [Link(here, base, 5.0), air(here, f"air_{side}", 0.6), air(here, "enclosure", 0.2)]
            links += [Link(here, "coolant", 6.0 if end == "front" else 3.0, SPLASH), air(base, f"air_{side}", 0.2)]
    return links


def _table() -> list[Link]:
    links = [Link("table_left", "table_right", 8.0)]
    for part in ("front", "rear", "base"):
        links.append(Link(f"saddle_left_{part}", f"saddle_right_{part}", conductance(CAST_IRON, 0.02, 0.6)))
    for side in SIDES:
        front, rear, base = (f"saddle_{side}_{part}" for part in ("front", "rear", "base"))
        table = f"table_{side}"
        links += [Link(front, rear, 3.0), Link(front, base, 14.0), Link(rear, base, 14.0)]
        links += [Link(base, f"bed_front_{side}", 2.0), Link(base, f"bed_rear_{side}", 2.0)]
        links += [air(part, "enclosure", 0.25) for part in (front, rear)]
        links += [Link(table, front, 2.5), Link(table, rear, 2.5), air(table, "enclosure", 0.6)]
        links += [Link(table, "coolant", 25.0, SPLASH), Link(front, "coolant", 3.0, SPLASH)]
    return links


def _screw(screw: Screw, near: str, mount: dict[str, float], nut: dict[str, float], around: str) -> list[Link]:
    """Return a screw's links: to the motor at its end `near`, that motor's mount, the nut's body, the air."""
    axis = "xyz"[screw.axis]
    piece_m = (screw.edges_mm[1] - screw.edges_mm[0]) / 1e3
    along = conductance(STEEL, SCREW_SECTION_M2, piece_m)
    links = [Link(a, b, along) for a, b in zip(screw.nodes[:-1], screw.nodes[1:], strict=True)]
    links += [air(node, around, SCREW_GIRTH_M * piece_m, TURNING) for node in screw.nodes]
    links += [Link(screw.nodes[-1], near, 2.0 * along), air(near, around, 0.25)]
    links += [Link(near, node, W_per_K) for node, W_per_K in mount.items()]
    links += [Link(f"nut_{axis}", node, W_per_K) for node, W_per_K in nut.items()]
    return links + [Link(f"nut_{axis}", node, 0.3) for node in screw.nodes]


def _screws() -> list[Link]:
    saddle = {f"saddle_right_{part}": 2.0 for part in ("front", "rear", "base")}
    column = {"column_upper_left": 2.5, "column_upper_right": 2.5}
    return [
        *_screw(SCREWS[0], "motor_x", saddle, {f"table_{side}": 2.0 for side in SIDES}, "enclosure"),
        *_screw(
            SCREWS[1],
            "motor_y",
            {f"bed_rear_{side}": 3.0 for side in SIDES},
            {f"saddle_{side}_base": 2.0 for side in SIDES},
            "enclosure",
        ),
        *_screw(SCREWS[2], "motor_z", column, {f"head_rear_{side}": 2.0 for side in SIDES}, "air_high"),
    ]


def _surroundings() -> list[Link]:
    return [
        Link("coolant", "enclosure", 10.0, Film(coolant=3.0)),
        Link("coolant", "air_left", 25.0),
        *(Link("enclosure", f"air_{place}", 12.0, DOOR) for place in ("left", "right", "high")),
    ]


def _capacities() -> dict[str, float]:
    nodes = {name: capacity(STEEL, kg) for name, kg in STEEL_KG.items()}
    nodes |= {name: capacity(CAST_IRON, kg) for name, kg in IRON_KG.items()}
    for screw in SCREWS:
        piece_m = (screw.edges_mm[1] - screw.edges_mm[0]) / 1e3
        nodes |= {name: capacity(STEEL, SCREW_KG_PER_M * piece_m) for name in screw.nodes}
    return nodes | {
        "coolant": 250.0 * COOLANT_J_PER_KG_K,  # a tank of 250 l
        "enclosure": 8e4,  # 7 m³ of air and 150 kg of sheet metal
    }


def _sources() -> tuple[Source, ...]:
    # Angular contact balls of 70 and 60 mm bore, oil and air: f0 = 1 (Harris and Kotzalas,
    # table of f0), ν = 12 mm²/s when warm.
    front = BearingFriction(2, 90.0, 1.0, 12.0, 40.0)
    rear = BearingFriction(2, 78.0, 1.0, 12.0, 30.0)
    motor = PowerLaw(500.0, 12000.0, 1.2)  # iron and copper losses of 15 kW
    sources: list[Source] = [
        SpindleSource(front, {"spindle_front": 0.65, "spindle_shaft": 0.35}, load_sensitivity=1.0),
        SpindleSource(rear, {"spindle_rear": 0.65, "spindle_shaft": 0.35}, load_sensitivity=0.3),
        SpindleSource(motor, {"motor": 0.85, "head_front_left": 0.05, "head_front_right": 0.1}, load_sensitivity=0.8),
        StandingSource({"column_lower_left": 0.7, "column_lower_rear": 0.3}, always_W=60.0),  # hydraulics
        StandingSource({"coolant": 1.0}, coolant_W=350.0),  # pump
        StandingSource({"coolant": 0.5, "table_left": 0.2, "table_right": 0.3}, load_W=500.0),  # chips
    ]
    guides = (
        {f"saddle_{side}_{part}": 0.25 for side in SIDES for part in ("front", "rear")},
        {f"bed_{end}_{side}": 0.25 for end in ("front", "rear") for side in SIDES},
        {f"column_{level}_{side}": 0.25 for level in ("lower", "upper") for side in SIDES},
    )
    for k, screw in enumerate(SCREWS):
        axis = "xyz"[k]
        nut = PowerLaw(65.0, FEED, 1.2)
        sources += [
            FeedSource(k, PowerLaw(80.0, FEED, 1.3), {f"motor_{axis}": 1.0}),
            FeedSource(k, nut, {f"nut_{axis}": 0.55}),
            StrokeSource(screw, nut, 0.45),
            FeedSource(k, PowerLaw(40.0, FEED, 1.0), guides[k]),
        ]
    # A vertical axis' motor holds the head's weight.
    return (*sources, StandingSource({"motor_z": 1.0}, always_W=25.0))


THERMOMETERS = {
    "spindle_front": Thermometer({"spindle_front": 0.8, "chiller": 0.2}, lag_s=40.0),
    "spindle_rear": Thermometer({"spindle_rear": 0.7, "head_front_right": 0.3}, lag_s=120.0),
    "motor": Thermometer({"motor": 1.0}, lag_s=60.0),
    "head": Thermometer({"head_front_low": 0.7, "head_rear_left": 0.3}, lag_s=60.0),
    "column_front": Thermometer({"column_upper_left": 0.8, "column_lower_left": 0.2}, lag_s=60.0),
    "column_rear": Thermometer({"column_lower_rear": 0.6, "column_upper_rear": 0.4}, lag_s=60.0),
    "bed": Thermometer({"bed_front_left": 1.0}, lag_s=60.0),
    "nut_x": Thermometer({"nut_x": 0.8, "table_right": 0.2}, lag_s=60.0),
    "nut_y": Thermometer({"nut_y": 0.8, "saddle_left_base": 0.2}, lag_s=60.0),
    "nut_z": Thermometer({"nut_z": 0.8, "head_rear_right": 0.2}, lag_s=60.0),
    "coolant": Thermometer({"coolant": 1.0}, lag_s=60.0),
    "ambient": Thermometer({"air_right": 1.0}, lag_s=180.0),
}

VMC3 = Design(
    name="vmc3",
    network=Network(
        _capacities(), BOUNDARIES, (*_head(), *_column(), *_bed(), *_table(), *_screws(), *_surroundings())
    ),
    sources=_sources(),
    structure=STRUCTURE,
    thermometers=THERMOMETERS,
    capability=Capability(12000.0, 15000.0, ((0.0, 800.0), (0.0, 500.0), (0.0, 500.0))),
)
