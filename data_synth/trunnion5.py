"""Thermal design of `trunnion5`: a five-axis machining centre of eight tonnes, 18 000 rpm, table of 500 mm.

Masses and areas are those of a machine of this class; they and all contact conductances, shares of heat and
losses in this file are chosen, not measured, so that parts settle as tests report: spindle within an hour or two,
bed and portal over a shift. Torque motors turn table and cradle; they have cooling jackets, and still are what
warms the workpiece's side most. Films of air come from materials.py over the part's surface; conduction in walls
and screws is k A / L.
"""

from __future__ import annotations

from data_synth.building_blocks import (
    SPLASH,
    air,
    feed_sources,
    hull_links,
    iron,
    joined,
    rotary_links,
    rotary_sources,
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
from data_synth.sensors import Thermometer
from data_synth.trunnion5_structure import RODS, SCREWS, STRUCTURE

SIDES, ENDS, LEVELS = ("left", "right"), ("front", "rear"), ("low", "high")
FEED = 15000.0  # mm/min at which the losses of a linear axis are given
TURN_A, TURN_C = 3600.0, 18000.0  # degree/min at which those of cradle and table are given: 10 and 50 turns a minute

IRON_KG = {
    **{f"bed_{end}_{part}": 620.0 for end in ENDS for part in (*SIDES, "base")},
    **{f"portal_{side}_{part}": 190.0 for side in SIDES for part in (*LEVELS, "rear")},
    **{f"slide_{level}_{side}": 90.0 for level in LEVELS for side in SIDES},
    **{f"ram_{level}_{part}": 42.0 for level in LEVELS for part in (*SIDES, "rear")},
    **{f"cradle_{side}_{part}": 65.0 for side in SIDES for part in ("arm", *ENDS)},
    **{f"table_{part}": 32.0 for part in (*SIDES, *ENDS)},
}
STEEL_KG = {
    "spindle_front": 18.0,
    "spindle_rear": 11.0,
    "spindle_shaft": 18.0,
    "motor": 42.0,  # stator in its jacket
    **{"motor_x": 26.0, "motor_y": 46.0, "motor_z": 22.0},  # with coupling and fixed bearing; Y has two
    **{"nut_x": 8.0, "nut_y": 16.0, "nut_z": 7.0},  # with their brackets
    **{f"motor_a_{side}": 55.0 for side in SIDES},
    **{f"bearing_a_{side}": 26.0 for side in SIDES},
    "motor_c": 60.0,
    "bearing_c": 32.0,
    **{f"guide_x_{level}": 40.0 for level in LEVELS},  # rails with their carriages
    **{f"guide_y_{side}": 50.0 for side in SIDES},
    **{f"guide_z_{side}": 25.0 for side in SIDES},
    "workpiece": 50.0,  # with its fixture
}


def _ram() -> list[Link]:
    links = spindle_links(
        front={"ram_low_left": 6.5, "ram_low_right": 6.5, "ram_low_rear": 5.0},
        rear={f"ram_high_{part}": 3.0 for part in (*SIDES, "rear")},
        around="enclosure",
        to_chiller=(48.0, 30.0),
        to_shaft=(17.0, 13.0),
    )
    links += joined("motor", {"chiller": 85.0, "spindle_shaft": 5.0})  # jacket; air gap
    links += joined("motor", {"ram_low_left": 3.0, "ram_low_right": 3.0, "ram_low_rear": 2.3})
    wall = conductance(CAST_IRON, 0.008, 0.5)
    for part in (*SIDES, "rear"):
        links += [Link(f"ram_low_{part}", f"ram_high_{part}", wall), air(f"ram_low_{part}", "enclosure", 0.15)]
        links.append(air(f"ram_high_{part}", "air_high", 0.15))
    for level in LEVELS:
        links += [Link(f"ram_{level}_{side}", f"ram_{level}_rear", 4.0) for side in SIDES]
        links.append(Link(f"ram_{level}_left", f"ram_{level}_right", 3.0))
        for side in SIDES:
            guide = f"guide_z_{side}"
            links += [Link(guide, f"ram_{level}_{side}", 6.0), Link(guide, f"ram_{level}_rear", 2.4)]
            links.append(Link(guide, f"slide_{level}_{side}", 9.0))
    return [*links, Link("ram_low_left", "chiller", 2.5)]  # its pipes run down the left side


def _portal() -> list[Link]:
    links = []
    beam = conductance(CAST_IRON, 0.015, 0.8)
    for part in (*LEVELS, "rear"):
        links.append(Link(f"portal_left_{part}", f"portal_right_{part}", beam))
    for level in LEVELS:
        links.append(Link(f"slide_{level}_left", f"slide_{level}_right", 6.0))
    for side in SIDES:
        low, high, rear = (f"portal_{side}_{part}" for part in (*LEVELS, "rear"))
        links += [Link(low, high, 4.0), Link(low, rear, 3.0), Link(high, rear, 3.0)]
        links += [air(low, "enclosure", 0.5), air(high, "air_high", 0.4), air(rear, "air_high", 0.6)]
        links += [Link(f"guide_y_{side}", part, 6.0) for part in (low, rear)]
        links += [Link(f"guide_y_{side}", f"bed_{end}_{side}", 6.0) for end in ENDS]
        links += [Link(f"slide_low_{side}", f"slide_high_{side}", 6.0)]
        for level in LEVELS:
            slide = f"slide_{level}_{side}"
            links += [air(slide, "enclosure" if level == "low" else "air_high", 0.2)]
            links += [Link(f"guide_x_{level}", part, 6.0) for part in (slide, f"portal_{side}_{level}")]
    return links


def _bed() -> list[Link]:
    links = []
    for part in (*SIDES, "base"):
        links.append(Link(f"bed_front_{part}", f"bed_rear_{part}", conductance(CAST_IRON, 0.04, 0.9)))
    for end in ENDS:
        base = f"bed_{end}_base"
        links += [Link(base, "floor", 8.0), Link(base, "coolant", 6.0, SPLASH)]
        for side in SIDES:
            here = f"bed_{end}_{side}"
            links += [Link(here, base, 6.0), air(here, f"air_{side}", 1.0), air(here, "enclosure", 0.5)]
            links += [Link(here, "coolant", 6.0, SPLASH), air(base, f"air_{side}", 0.3)]
    return links


def _cradle() -> list[Link]:
    table = {f"table_{part}": 6.0 for part in (*SIDES, *ENDS)}
    base = {f"cradle_{side}_{end}": 5.0 for side in SIDES for end in ENDS}
    links = rotary_links("c", stands=base, turns=table, jacket_W_per_K=26.0)
    links += joined("workpiece", {node: 0.6 * W_per_K for node, W_per_K in table.items()})
    links += [air("workpiece", "enclosure", 0.3), Link("workpiece", "coolant", 20.0, SPLASH)]
    for side in SIDES:
        bed = {f"bed_{end}_{side}": 5.0 for end in ENDS}
        links += rotary_links(f"a_{side}", stands=bed, turns={f"cradle_{side}_arm": 14.0}, jacket_W_per_K=22.0)
    bottom = conductance(CAST_IRON, 0.012, 0.5)
    for end in ENDS:
        links.append(Link(f"cradle_left_{end}", f"cradle_right_{end}", bottom))
        links += [Link(f"table_{end}", f"table_{side}", 6.0) for side in SIDES]
    for side in SIDES:
        arm = f"cradle_{side}_arm"
        links += [air(arm, "enclosure", 0.2), Link(arm, "coolant", 6.0, SPLASH)]
        links.append(Link(f"cradle_{side}_front", f"cradle_{side}_rear", 4.0))
        for end in ENDS:
            here = f"cradle_{side}_{end}"
            links += [Link(arm, here, 5.0), air(here, "enclosure", 0.15), Link(here, "coolant", 6.0, SPLASH)]
    for part in (*SIDES, *ENDS):
        links += [air(f"table_{part}", "enclosure", 0.15), Link(f"table_{part}", "coolant", 8.0, SPLASH)]
    return links


def _screws() -> list[Link]:
    mounts = (
        {f"portal_right_{part}": 2.5 for part in LEVELS},
        {f"bed_rear_{side}": 4.0 for side in SIDES},
        {f"slide_high_{side}": 2.5 for side in SIDES},
    )
    nuts = (
        {f"slide_{level}_{side}": 1.5 for level in LEVELS for side in SIDES},
        {f"portal_{side}_{part}": 2.0 for side in SIDES for part in ("low", "rear")},
        {f"ram_high_{part}": 1.5 for part in (*SIDES, "rear")},
    )
    around = ("enclosure", "enclosure", "air_high")
    return [
        link
        for screw, rod, mount, nut, air_there in zip(SCREWS, RODS, mounts, nuts, around, strict=True)
        for link in screw_links(screw, rod, mount, nut, air_there)
    ]


def _capacities() -> dict[str, float]:
    nodes = steel(STEEL_KG) | iron(IRON_KG)
    for screw, rod in zip(SCREWS, RODS, strict=True):
        nodes |= screw_capacities(screw, rod)
    return nodes | {
        "coolant": 400.0 * COOLANT_J_PER_KG_K,  # a tank of 400 l
        "enclosure": 1.0e5,  # 8 m³ of air and 190 kg of sheet metal
    }


def _spindle_sources() -> list[Source]:
    # Angular contact balls of 70 and 55 mm bore, oil and air: f0 = 1 (Harris and Kotzalas,
    # table of f0), ν = 12 mm²/s when warm.
    front = BearingFriction(2, 90.0, 1.0, 12.0, 40.0)
    rear = BearingFriction(2, 72.0, 1.0, 12.0, 25.0)
    motor = PowerLaw(1400.0, 18000.0, 1.3)  # iron and copper losses of 25 kW, built in
    return [
        SpindleSource(front, {"spindle_front": 0.65, "spindle_shaft": 0.35}, load_sensitivity=1.0),
        SpindleSource(rear, {"spindle_rear": 0.65, "spindle_shaft": 0.35}, load_sensitivity=0.3),
        SpindleSource(motor, {"motor": 0.88, "spindle_shaft": 0.12}, load_sensitivity=0.8),
        SpindleStartSource({"motor": 0.7, "spindle_shaft": 0.3}, inertia_kg_m2=0.035, lost=0.25),
    ]


def _linear_sources() -> list[Source]:
    guides = (
        {f"guide_x_{level}": 0.5 for level in LEVELS},
        {f"guide_y_{side}": 0.5 for side in SIDES},
        {f"guide_z_{side}": 0.5 for side in SIDES},
    )
    moved_kg = (1500.0, 3400.0, 900.0)  # with screw and rotor, which count as much as the slide itself
    number = (1, 2, 1)  # of motors and screws
    sources: list[Source] = []
    for screw, onto, kg, n in zip(SCREWS, guides, moved_kg, number, strict=True):
        motor, nut = PowerLaw(90.0 * n, FEED, 1.3), PowerLaw(85.0 * n, FEED, 1.2)
        sources += feed_sources(screw, onto, motor, nut, PowerLaw(50.0, FEED, 1.0))
        # A motor of 1.3 N m/A on a lead of 16 mm gives 510 N/A; 0.7 ohm for its three windings.
        # Two motors halve the current and double the resistance that it passes.
        sources.append(
            AccelerationSource(
                screw.axis, {f"motor_{screw.axis.lower()}": 1.0}, kg, acceleration=6.0, per_ampere=510.0 * n,
                ohm=0.7 * n, rapid_per_min=50000.0,
            )
        )  # fmt: skip
    return [*sources, StandingSource({"motor_z": 1.0}, always_W=35.0)]  # it holds the ram's weight


def _rotary_sources() -> list[Source]:
    arms = {f"cradle_{side}_arm": 0.1 for side in SIDES}
    table = {f"table_{part}": 0.06 for part in (*SIDES, *ENDS)}
    stators = {f"motor_a_{side}": 0.5 for side in SIDES}
    return [
        *rotary_sources("A", ("a_left", "a_right"), PowerLaw(320.0, TURN_A, 1.0), PowerLaw(80.0, TURN_A, 1.0), arms),
        *rotary_sources("C", ("c",), PowerLaw(1300.0, TURN_C, 1.3), PowerLaw(380.0, TURN_C, 1.3), table),
        # Torque motors: cradle 60 kg m² at 15 rad/s², table with workpiece 12 kg m² at 40 rad/s².
        AccelerationSource("A", stators, 60.0, 15.0, per_ampere=45.0, ohm=2.4, rapid_per_min=9000.0),
        AccelerationSource("C", {"motor_c": 1.0}, 12.0, 40.0, per_ampere=22.0, ohm=1.8, rapid_per_min=32000.0),
        # The cradle's weight is not balanced: its motors hold it, on and on.
        StandingSource(stators, always_W=160.0),
    ]


def _sources() -> tuple[Source, ...]:
    # Chips fall where the table stands, and it stands more often than it turns.
    table = {"table_left": 0.05, "table_right": 0.05, "table_front": 0.08, "table_rear": 0.02}
    return (
        *_spindle_sources(),
        *_linear_sources(),
        *_rotary_sources(),
        StandingSource({"bed_rear_right": 0.7, "bed_rear_base": 0.3}, always_W=80.0),  # hydraulics
        StandingSource({"coolant": 1.0}, coolant_W=550.0),  # pumps
        StandingSource({"coolant": 0.6, "workpiece": 0.2, **table}, load_W=600.0),  # chips
    )


THERMOMETERS = {
    "spindle_front": Thermometer({"spindle_front": 0.8, "chiller": 0.2}, lag_s=40.0),
    "spindle_rear": Thermometer({"spindle_rear": 0.7, "ram_high_right": 0.3}, lag_s=120.0),
    "motor": Thermometer({"motor": 1.0}, lag_s=60.0),
    "ram": Thermometer({"ram_low_left": 0.7, "ram_high_left": 0.3}, lag_s=60.0),
    "portal": Thermometer({"portal_right_low": 0.6, "portal_right_rear": 0.4}, lag_s=60.0),
    "bed": Thermometer({"bed_front_left": 1.0}, lag_s=60.0),
    "nut_x": Thermometer({"nut_x": 0.8, "slide_low_right": 0.2}, lag_s=60.0),
    "nut_y": Thermometer({"nut_y": 0.8, "portal_left_low": 0.2}, lag_s=60.0),
    "nut_z": Thermometer({"nut_z": 0.8, "ram_high_rear": 0.2}, lag_s=60.0),
    "motor_a": Thermometer({"motor_a_left": 1.0}, lag_s=60.0),
    "bearing_a": Thermometer({"bearing_a_right": 0.7, "bed_front_right": 0.3}, lag_s=60.0),
    "motor_c": Thermometer({"motor_c": 1.0}, lag_s=60.0),
    "bearing_c": Thermometer({"bearing_c": 0.7, "cradle_left_front": 0.3}, lag_s=60.0),
    "coolant": Thermometer({"coolant": 1.0}, lag_s=60.0),
    "ambient": Thermometer({"air_right": 1.0}, lag_s=180.0),
}

TRUNNION5 = Design(
    name="trunnion5",
    network=Network(
        _capacities(),
        BOUNDARIES,
        (
            *_ram(),
            *_portal(),
            *_bed(),
            *_cradle(),
            *_screws(),
            *hull_links({"air_left": 12.0, "air_right": 12.0, "air_high": 12.0}, tank_W_per_K=50.0),
        ),
    ),
    sources=_sources(),
    structure=STRUCTURE,
    thermometers=THERMOMETERS,
    capability=Capability(
        18000.0,
        {"X": 18000.0, "Y": 18000.0, "Z": 18000.0, "A": 3600.0, "C": 14400.0},
        {"X": (-400.0, 400.0), "Y": (-350.0, 350.0), "Z": (0.0, 550.0), "A": (-120.0, 30.0), "C": (-360.0, 360.0)},
    ),
)
