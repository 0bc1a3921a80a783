"""Thermal design of vertical machines with a C frame, of which `vmc3` and `seed3` are two.

Masses and areas are those of machines of some five tonnes; they and all contact conductances, shares of heat and
losses in this file are chosen, not measured, so that parts settle as tests report: spindle within an hour or two,
column and bed over a shift. Films of air come from materials.py over the part's surface; conduction in walls and
screws is k A / L.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from data_synth.assembly import Structure
from data_synth.building_blocks import (
    FAN,
    SPLASH,
    Rod,
    air,
    feed_sources,
    hull_links,
    iron,
    screw_capacities,
    screw_links,
    spindle_links,
    steel,
)
from data_synth.capability import Capability
from data_synth.design import Design
from data_synth.environment import BOUNDARIES
from data_synth.heat import (
    AccelerationSource,
    BearingFriction,
    PowerLaw,
    Source,
    SpindleSource,
    SpindleStartSource,
    StandingSource,
)
from data_synth.materials import CAST_IRON, COOLANT_J_PER_KG_K, conductance
from data_synth.network import Link, Network
from data_synth.screw import Screw
from data_synth.sensors import Thermometer

SIDES, ENDS = ("left", "right"), ("front", "rear")
FEED = 10000.0  # mm/min at which the losses of an axis are given
ROD = Rod(40.0)
N_PER_A = 470.0  # a motor of 1.2 N m/A on a screw of 16 mm lead

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
    **{f"guide_x_{end}": 35.0 for end in ENDS},  # rails with their carriages, or ways and gibs
    **{f"guide_{axis}_{side}": 30.0 for axis in "yz" for side in SIDES},
    "workpiece": 60.0,  # with its vice
}


@dataclass(frozen=True)
class Figures:
    """What tells one machine of this kind from another.

    Attributes
    ----------
    front, rear, motor : heat of the spindle's bearings and motor by its speed
    motor_onto : nodes by share
    to_chiller : from the front bearings and from the rear ones, and from the head's pipes [W/K]; zero without one
    guides : friction of one axis' guides by its feed
    moved_kg : what X, Y, Z move, with what screw and rotor stand for
    acceleration : [m/s²]
    rapid_mm_per_min : of each axis
    iron : share of `IRON_KG` that its castings weigh
    """

    name: str
    structure: Structure
    screws: tuple[Screw, Screw, Screw]
    front: BearingFriction
    rear: BearingFriction
    motor: PowerLaw
    to_chiller: tuple[float, float, float]
    guides: PowerLaw
    moved_kg: tuple[float, float, float]
    acceleration: float
    rapid_mm_per_min: float
    thermometers: Mapping[str, Thermometer]
    capability: Capability
    iron: float = 1.0


def design(figures: Figures) -> Design:
    """Return the thermal design of one machine."""
    links = (
        *_head(figures),
        *_column(),
        *_bed(),
        *_table(),
        *_screws(figures.screws),
        *hull_links({f"air_{place}": 12.0 for place in ("left", "right", "high")}),
    )
    return Design(
        name=figures.name,
        network=Network(_capacities(figures), BOUNDARIES, links),
        sources=_sources(figures),
        structure=figures.structure,
        thermometers=figures.thermometers,
        capability=figures.capability,
    )


def _head(figures: Figures) -> list[Link]:
    front, rear, pipes = figures.to_chiller
    links = [
        *spindle_links(
            {"head_front_low": 14.0}, {f"head_front_{side}": 5.0 for side in SIDES}, "enclosure", (front, rear)
        ),
        air("motor", "air_high", 1.0, FAN),  # ribs and a fan
        Link("head_front_left", "chiller", pipes),  # its pipes run down the left side
        Link("head_front_left", "head_front_right", 5.0),
        Link("head_rear_left", "head_rear_right", 8.0),
        air("head_front_low", "enclosure", 0.5),
    ]
    for side in SIDES:
        rear_node, front_node = f"head_rear_{side}", f"head_front_{side}"
        links += [Link("motor", front_node, 3.0), Link("head_front_low", front_node, 5.0)]
        links += [Link(rear_node, "head_front_low", 6.0), Link(rear_node, front_node, 6.0)]
        links += [air(front_node, "air_high", 0.25), air(rear_node, "air_high", 0.35)]
        guide = f"guide_z_{side}"
        links += [Link(guide, rear_node, 24.0), Link(guide, f"column_upper_{side}", 7.5)]
        links += [Link(guide, f"column_lower_{side}", 4.5)]
    return [link for link in links if link.W_per_K]


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
        links += [Link(f"guide_y_{side}", part, 6.0) for part in (base, f"bed_front_{side}", f"bed_rear_{side}")]
        links += [air(part, "enclosure", 0.25) for part in (front, rear)]
        for end, part in zip(ENDS, (front, rear), strict=True):
            links += [Link(f"guide_x_{end}", part, 5.0), Link(f"guide_x_{end}", table, 5.0)]
        links += [Link(table, "coolant", 20.0, SPLASH), Link(front, "coolant", 3.0, SPLASH)]
        links += [air(table, "enclosure", 0.5), Link("workpiece", table, 6.0)]
    return [*links, air("workpiece", "enclosure", 0.3), Link("workpiece", "coolant", 10.0, SPLASH)]


def _screws(screws: tuple[Screw, Screw, Screw]) -> list[Link]:
    saddle = {f"saddle_right_{part}": 2.0 for part in ("front", "rear", "base")}
    bed = {f"bed_rear_{side}": 3.0 for side in SIDES}
    column = {"column_upper_left": 2.5, "column_upper_right": 2.5}
    nuts = ("table_{}", "saddle_{}_base", "head_rear_{}")
    links: list[Link] = []
    for screw, mount, nut, around in zip(
        screws, (saddle, bed, column), nuts, ("enclosure", "enclosure", "air_high"), strict=True
    ):
        links += screw_links(screw, ROD, mount, {nut.format(side): 2.0 for side in SIDES}, around)
    return links


def _capacities(figures: Figures) -> dict[str, float]:
    nodes = steel(STEEL_KG) | iron({name: figures.iron * kg for name, kg in IRON_KG.items()})
    for screw in figures.screws:
        nodes |= screw_capacities(screw, ROD)
    return nodes | {
        "coolant": 250.0 * COOLANT_J_PER_KG_K,  # a tank of 250 l
        "enclosure": 8e4,  # 7 m³ of air and 150 kg of sheet metal
    }


def _sources(figures: Figures) -> tuple[Source, ...]:
    motor = {"motor": 0.85, "head_front_left": 0.05, "head_front_right": 0.1}
    sources: list[Source] = [
        SpindleSource(figures.front, {"spindle_front": 0.65, "spindle_shaft": 0.35}, load_sensitivity=1.0),
        SpindleSource(figures.rear, {"spindle_rear": 0.65, "spindle_shaft": 0.35}, load_sensitivity=0.3),
        SpindleSource(figures.motor, motor, load_sensitivity=0.8),
        SpindleStartSource({"motor": 1.0}, inertia_kg_m2=0.05, lost=0.3),
        StandingSource({"column_lower_left": 0.7, "column_lower_rear": 0.3}, always_W=60.0),  # hydraulics
        StandingSource({"coolant": 1.0}, coolant_W=350.0),  # pump
        StandingSource(
            {"coolant": 0.5, "workpiece": 0.2, "table_left": 0.1, "table_right": 0.2}, load_W=500.0
        ),  # chips
    ]
    guides = (
        {f"guide_x_{end}": 0.5 for end in ENDS},
        {f"guide_y_{side}": 0.5 for side in SIDES},
        {f"guide_z_{side}": 0.5 for side in SIDES},
    )
    for k, screw in enumerate(figures.screws):
        sources += feed_sources(screw, guides[k], PowerLaw(80.0, FEED, 1.3), PowerLaw(65.0, FEED, 1.2), figures.guides)
        sources.append(
            AccelerationSource(
                screw.axis,
                {f"motor_{screw.axis.lower()}": 1.0},
                figures.moved_kg[k],
                figures.acceleration,
                N_PER_A,
                0.5,
                figures.rapid_mm_per_min,
            )
        )
    # A vertical axis' motor holds the head's weight.
    return (*sources, StandingSource({"motor_z": 1.0}, always_W=25.0))
