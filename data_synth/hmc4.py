"""Thermal design of `hmc4`: a horizontal machining centre of twelve tonnes, 10 000 rpm, a pallet of 630 mm.

Masses and areas are those of a machine of this class; they and all contact conductances, shares of heat and
losses in this file are chosen, not measured, so that parts settle as tests report: spindle within an hour or two,
column and bed over a shift. Films of air come from materials.py over the part's surface; conduction in walls and
screws is k A / L.
"""

from __future__ import annotations

from itertools import product

from data_synth.building_blocks import (
    FAN,
    SPLASH,
    air,
    feed_sources,
    hull_links,
    iron,
    joined,
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
    FeedSource,
    PowerLaw,
    Source,
    SpindleSource,
    SpindleStartSource,
    StandingSource,
)
from data_synth.hmc4_structure import ROD, SCREWS, STRUCTURE
from data_synth.materials import CAST_IRON, COOLANT_J_PER_KG_K, conductance
from data_synth.network import Link, Network
from data_synth.sensors import Thermometer

SIDES, ENDS, LEVELS = ("left", "right"), ("front", "rear"), ("lower", "upper")
FEED = 15000.0  # mm/min at which the losses of a linear axis are given
TURN = 3600.0  # degree/min at which those of the table are given: ten turns a minute

IRON_KG = {
    **{f"bed_stem_{end}_{part}": 450.0 for end in ENDS for part in (*SIDES, "base")},
    **{f"bed_cross_{side}_{part}": 450.0 for side in SIDES for part in (*ENDS, "base")},
    **{f"column_{level}_{end}_{side}": 375.0 for level in LEVELS for end in ENDS for side in SIDES},
    **{f"head_front_{level}_{side}": 110.0 for level in LEVELS for side in SIDES},
    **{f"head_rear_{side}": 150.0 for side in SIDES},
    **{f"saddle_{end}_{side}": 260.0 for end in ENDS for side in SIDES},
    "table": 380.0,
    **{f"pallet_{end}_{side}": 110.0 for end in ENDS for side in SIDES},
}
STEEL_KG = {
    "spindle_front": 32.0,
    "spindle_rear": 20.0,
    "spindle_shaft": 34.0,
    "motor": 110.0,
    **{f"motor_{axis}": 32.0 for axis in "xyz"},  # with coupling, fixed bearing and its housing
    **{f"nut_{axis}": 10.0 for axis in "xyz"},  # with its bracket
    "motor_b": 18.0,
    "worm_b": 40.0,  # with its wheel's rim and the oil around it
    "bearing_b": 45.0,
    **{f"guide_x_{end}": 70.0 for end in ENDS},  # rails with their carriages
    **{f"guide_{axis}_{side}": 60.0 for axis in "yz" for side in SIDES},
    "workpiece": 150.0,  # with its fixture
}


def _head() -> list[Link]:
    links = spindle_links(
        front={f"head_front_{level}_{side}": 7.0 for level in LEVELS for side in SIDES},
        rear={f"head_rear_{side}": 7.0 for side in SIDES},
        around="enclosure",
        to_chiller=(45.0, 30.0),
        to_shaft=(16.0, 12.0),
    )
    links.append(air("motor", "air_high", 1.6, FAN))  # ribs and a fan
    links.append(Link("head_rear_left", "head_rear_right", 9.0))
    for level in LEVELS:
        links.append(Link(f"head_front_{level}_left", f"head_front_{level}_right", 6.0))
    for side in SIDES:
        rear = f"head_rear_{side}"
        links += [Link(f"head_front_lower_{side}", f"head_front_upper_{side}", 6.0), Link("motor", rear, 4.0)]
        links += [Link(f"head_front_{level}_{side}", rear, 7.0) for level in LEVELS]
        links += [air(f"head_front_{level}_{side}", "enclosure", 0.2) for level in LEVELS]
        links += [air(rear, "air_high", 0.4), Link(f"guide_y_{side}", rear, 12.0)]
        links += [Link(f"guide_y_{side}", f"column_{level}_front_{side}", 6.0) for level in LEVELS]
    links.append(Link("head_front_upper_left", "chiller", 3.0))  # its pipes come in there
    return links


def _column() -> list[Link]:
    links = []
    wall = conductance(CAST_IRON, 0.022, 0.9)
    for level in LEVELS:
        for end, across in (("front", 1.5), ("rear", 2.5)):  # the front is open where the head runs
            links.append(Link(f"column_{level}_{end}_left", f"column_{level}_{end}_right", across))
    for side, end in product(SIDES, ENDS):
        lower, upper = f"column_lower_{end}_{side}", f"column_upper_{end}_{side}"
        links += [Link(lower, upper, wall)]
        links += [Link(f"guide_x_{end}", lower, 10.0), Link(f"guide_x_{end}", f"bed_cross_{side}_{end}", 10.0)]
        links += [air(lower, f"air_{side}", 0.7), air(upper, "air_high", 0.9)]
        if end == "front":
            links += [air(part, "enclosure", 0.35) for part in (lower, upper)]
    for side, level in product(SIDES, LEVELS):
        links.append(Link(f"column_{level}_front_{side}", f"column_{level}_rear_{side}", 3.0))
    return links


def _bed() -> list[Link]:
    links = []
    for part in (*SIDES, "base"):
        links.append(Link(f"bed_stem_front_{part}", f"bed_stem_rear_{part}", conductance(CAST_IRON, 0.045, 0.9)))
    for part in (*ENDS, "base"):
        links.append(Link(f"bed_cross_left_{part}", f"bed_cross_right_{part}", conductance(CAST_IRON, 0.05, 0.9)))
    for end in ENDS:
        base = f"bed_stem_{end}_base"
        links += [Link(f"bed_stem_{end}_left", f"bed_stem_{end}_right", 3.0), Link(base, "floor", 8.0)]
        for side in SIDES:
            here = f"bed_stem_{end}_{side}"
            links += [Link(here, base, 6.0), air(here, f"air_{side}", 0.7), air(here, "enclosure", 0.3)]
            links += [Link(here, "coolant", 8.0 if end == "front" else 5.0, SPLASH), air(base, f"air_{side}", 0.2)]
    for side in SIDES:
        front, rear, base = (f"bed_cross_{side}_{part}" for part in (*ENDS, "base"))
        links += [Link(front, rear, 3.0), Link(front, base, 7.0), Link(rear, base, 7.0), Link(base, "floor", 8.0)]
        links += [air(part, f"air_{side}", 0.6) for part in (front, rear, base)]
        links += [Link(f"bed_stem_rear_{side}", front, 9.0), Link("bed_stem_rear_base", base, 5.0)]
    return links


def _table() -> list[Link]:
    links = joined("bearing_b", {"table": 22.0, **{f"saddle_{end}_{side}": 4.0 for end in ENDS for side in SIDES}})
    links += joined("worm_b", {"table": 5.0, "saddle_front_left": 5.0, "saddle_front_right": 5.0, "motor_b": 3.0})
    links += [*joined("motor_b", {f"saddle_front_{side}": 1.5 for side in SIDES}), air("motor_b", "enclosure", 0.2)]
    links += joined("workpiece", {f"pallet_{end}_{side}": 6.0 for end in ENDS for side in SIDES})
    links += [air("workpiece", "enclosure", 0.6), Link("workpiece", "coolant", 30.0, SPLASH)]
    links.append(air("table", "enclosure", 0.4))
    for end in ENDS:
        links.append(Link(f"saddle_{end}_left", f"saddle_{end}_right", 7.0))
        links.append(Link(f"pallet_{end}_left", f"pallet_{end}_right", 5.0))
    for side in SIDES:
        links.append(Link(f"saddle_front_{side}", f"saddle_rear_{side}", 7.0))
        links.append(Link(f"pallet_front_{side}", f"pallet_rear_{side}", 5.0))
    for end, side in product(ENDS, SIDES):
        saddle, pallet = f"saddle_{end}_{side}", f"pallet_{end}_{side}"
        links += [air(saddle, "enclosure", 0.3), Link(saddle, "coolant", 4.0, SPLASH)]
        links += [Link(f"guide_z_{side}", part, 6.0) for part in (saddle, f"bed_stem_{end}_{side}")]
        links += [Link(pallet, "table", 6.0), air(pallet, "enclosure", 0.25), Link(pallet, "coolant", 10.0, SPLASH)]
    return links


def _screws() -> list[Link]:
    mounts = (
        {f"bed_cross_right_{part}": 3.0 for part in ENDS},
        {f"column_upper_{end}_{side}": 1.5 for end in ENDS for side in SIDES},
        {f"bed_stem_rear_{side}": 3.0 for side in SIDES},
    )
    nuts = (
        {f"column_lower_{end}_{side}": 1.5 for end in ENDS for side in SIDES},
        {f"head_rear_{side}": 2.5 for side in SIDES},
        {f"saddle_{end}_{side}": 1.5 for end in ENDS for side in SIDES},
    )
    around = ("air_high", "enclosure", "enclosure")
    return [
        link
        for screw, mount, nut, air_there in zip(SCREWS, mounts, nuts, around, strict=True)
        for link in screw_links(screw, ROD, mount, nut, air_there)
    ]


def _capacities() -> dict[str, float]:
    nodes = steel(STEEL_KG) | iron(IRON_KG)
    for screw in SCREWS:
        nodes |= screw_capacities(screw, ROD)
    return nodes | {
        "coolant": 600.0 * COOLANT_J_PER_KG_K,  # a tank of 600 l
        "enclosure": 1.4e5,  # 12 m³ of air and 270 kg of sheet metal
    }


def _spindle_sources() -> list[Source]:
    # Angular contact balls of 100 and 85 mm bore, oil and air: f0 = 1 (Harris and Kotzalas,
    # table of f0), ν = 12 mm²/s when warm.
    front = BearingFriction(2, 125.0, 1.0, 12.0, 80.0)
    rear = BearingFriction(2, 105.0, 1.0, 12.0, 50.0)
    motor = PowerLaw(850.0, 10000.0, 1.2)  # iron and copper losses of 22 kW
    onto = {"motor": 0.9, "head_rear_left": 0.05, "head_rear_right": 0.05}
    return [
        SpindleSource(front, {"spindle_front": 0.65, "spindle_shaft": 0.35}, load_sensitivity=1.0),
        SpindleSource(rear, {"spindle_rear": 0.65, "spindle_shaft": 0.35}, load_sensitivity=0.3),
        SpindleSource(motor, onto, load_sensitivity=0.8),
        SpindleStartSource({"motor": 1.0}, inertia_kg_m2=0.12, lost=0.3),  # rotor, shaft and tool
    ]


def _axis_sources() -> list[Source]:
    guides = (
        {f"guide_x_{end}": 0.5 for end in ENDS},
        {f"guide_y_{side}": 0.5 for side in SIDES},
        {f"guide_z_{side}": 0.5 for side in SIDES},
    )
    moved_kg = (4200.0, 1300.0, 2300.0)  # with screw and rotor, which count as much as the slide itself
    sources: list[Source] = []
    for screw, onto, kg in zip(SCREWS, guides, moved_kg, strict=True):
        motor, nut, guide = PowerLaw(110.0, FEED, 1.3), PowerLaw(95.0, FEED, 1.2), PowerLaw(70.0, FEED, 1.0)
        sources += feed_sources(screw, onto, motor, nut, guide)
        # A motor of 1.6 N m/A on a lead of 16 mm gives 630 N/A; 0.6 ohm for its three windings.
        sources.append(
            AccelerationSource(
                screw.axis, {f"motor_{screw.axis.lower()}": 1.0}, kg, acceleration=5.0, per_ampere=630.0, ohm=0.6,
                rapid_per_min=50000.0,
            )
        )  # fmt: skip
    worm = {"worm_b": 0.7, "table": 0.3}
    return [
        *sources,
        StandingSource({"motor_y": 1.0}, always_W=45.0),  # a vertical axis' motor holds the head's weight
        FeedSource("B", PowerLaw(90.0, TURN, 1.1), worm),
        FeedSource("B", PowerLaw(35.0, TURN, 1.0), {"bearing_b": 0.6, "table": 0.4}),
        FeedSource("B", PowerLaw(60.0, TURN, 1.2), {"motor_b": 1.0}),
    ]


def _sources() -> tuple[Source, ...]:
    # Chips fall where the pallet stands, and it stands more often than it turns.
    pallet = {
        "pallet_front_left": 0.05,
        "pallet_front_right": 0.08,
        "pallet_rear_left": 0.02,
        "pallet_rear_right": 0.05,
    }
    return (
        *_spindle_sources(),
        *_axis_sources(),
        StandingSource({"bed_cross_left_rear": 0.6, "bed_cross_left_base": 0.4}, always_W=110.0),  # hydraulics
        StandingSource({"coolant": 1.0}, coolant_W=800.0),  # pumps, the one through the spindle too
        StandingSource({"coolant": 0.6, "workpiece": 0.2, **pallet}, load_W=700.0),  # chips
    )


THERMOMETERS = {
    "spindle_front": Thermometer({"spindle_front": 0.8, "chiller": 0.2}, lag_s=40.0),
    "spindle_rear": Thermometer({"spindle_rear": 0.7, "head_rear_right": 0.3}, lag_s=120.0),
    "motor": Thermometer({"motor": 1.0}, lag_s=60.0),
    "head": Thermometer({"head_front_upper_left": 0.7, "head_rear_left": 0.3}, lag_s=60.0),
    "column_front": Thermometer({"column_upper_front_left": 0.8, "column_lower_front_left": 0.2}, lag_s=60.0),
    "column_rear": Thermometer({"column_lower_rear_right": 0.6, "column_upper_rear_right": 0.4}, lag_s=60.0),
    "bed": Thermometer({"bed_stem_front_left": 1.0}, lag_s=60.0),
    "bed_rear": Thermometer({"bed_cross_left_front": 0.5, "bed_cross_left_base": 0.5}, lag_s=60.0),
    "nut_x": Thermometer({"nut_x": 0.8, "column_lower_front_right": 0.2}, lag_s=60.0),
    "nut_y": Thermometer({"nut_y": 0.8, "head_rear_right": 0.2}, lag_s=60.0),
    "nut_z": Thermometer({"nut_z": 0.8, "saddle_rear_left": 0.2}, lag_s=60.0),
    "worm_b": Thermometer({"worm_b": 0.8, "saddle_front_right": 0.2}, lag_s=60.0),
    "coolant": Thermometer({"coolant": 1.0}, lag_s=60.0),
    "ambient": Thermometer({"air_right": 1.0}, lag_s=180.0),
}

HMC4 = Design(
    name="hmc4",
    network=Network(
        _capacities(),
        BOUNDARIES,
        (
            *_head(),
            *_column(),
            *_bed(),
            *_table(),
            *_screws(),
            *hull_links({"air_left": 14.0, "air_right": 14.0, "air_high": 16.0}, tank_W_per_K=90.0),
        ),
    ),
    sources=_sources(),
    structure=STRUCTURE,
    thermometers=THERMOMETERS,
    capability=Capability(
        10000.0,
        {"X": 18000.0, "Y": 18000.0, "Z": 18000.0, "B": 5400.0},
        {"X": (-400.0, 400.0), "Y": (0.0, 700.0), "Z": (0.0, 750.0), "B": (-360.0, 360.0)},
    ),
)
