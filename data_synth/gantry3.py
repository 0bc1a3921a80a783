"""Thermal design of `gantry3`: an overhead gantry of 35 tonnes on a block of concrete, 4 x 2.5 x 1 m, 15 000 rpm.

Nobody conditions a hall of this height, so its layers of warm air and its day matter as much as the spindle: the walls
stand in them, the bridge has the warmest air above and the machine's own below, and the scales follow the air sooner
than what carries them. The hall's air on the one side (`air_left`) meets the near wall, on the other (`air_right`) the
far one.

Masses and areas are those of a machine of this class; they and all contact conductances, shares of heat and losses
in this file are chosen, not measured, so that the spindle settles within an hour, bridge and walls over a shift, the
block under the plate over days. Films of air come from materials.py over the part's surface; conduction in plates,
ribs and screws is k A / L.
"""

from __future__ import annotations

from itertools import pairwise, product

from data_synth.building_blocks import (
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
from data_synth.gantry3_structure import CONCRETE, ENDS, PLACES, ROD, SCALES_X, SCREW_Z, STRUCTURE, WALLS, WELDED
from data_synth.geometric import Workmanship
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
from data_synth.materials import CAST_IRON, COOLANT_J_PER_KG_K, capacity, conductance
from data_synth.network import Link, Network
from data_synth.sensors import Thermometer

LEVELS, FACES, SIDES = ("low", "high"), ("in", "out"), ("near", "far")
HALL = {"near": "air_left", "far": "air_right"}
FEED = 20000.0  # mm/min at which the losses of an axis are given

WELDED_KG = {
    **{f"wall_{s}_{e}_{v}_{f}": 1000.0 for s in WALLS for e in ENDS for v in LEVELS for f in FACES},
    **{f"bridge_{p}_{v}_{f}": 430.0 for p in PLACES for v in ("top", "bottom") for f in ("left", "right")},
}
IRON_KG = {
    **{f"plate_{e}_{s}_top": 2600.0 for e in ENDS for s in SIDES},
    **{f"carriage_{v}_{part}": 320.0 for v in LEVELS for part in (*SIDES, "back")},
}
STEEL_KG = {
    "head": 90.0,  # the ram's lower end around the spindle
    **{f"ram_{v}_{part}": 140.0 for v in LEVELS for part in (*SIDES, "left", "right")},
    "spindle_front": 18.0,
    "spindle_rear": 11.0,
    "spindle_shaft": 20.0,
    "motor": 32.0,  # the stator in its jacket
    **{f"motor_x_{side}": 45.0 for side in WALLS},  # with gear and pinion
    "motor_y": 45.0,
    "motor_z": 35.0,
    "nut_z": 10.0,
    **{f"guide_x_{side}": 180.0 for side in WALLS},  # rails with their shoes
    "guide_y": 110.0,
    "guide_z": 70.0,
    "workpiece": 800.0,  # with its fixture
}
BLOCK_M2, BLOCK_KG = 5.7, 11000.0  # of each quarter, 0.8 m deep
SCALE_J_PER_KG_K, SCALE_KG_PER_M, SCALE_GIRTH_M = 900.0, 2.5, 0.25  # aluminium profile [inc]; section chosen


def _plate() -> list[Link]:
    links = []
    for side in SIDES:
        left, right = (f"plate_{end}_{side}" for end in ENDS)
        links.append(Link(f"{left}_top", f"{right}_top", conductance(CAST_IRON, 0.4, 2.6)))
        links.append(Link(f"{left}_base", f"{right}_base", conductance(CONCRETE, 1.7, 2.6)))
    for end in ENDS:
        near, far = (f"plate_{end}_{side}" for side in SIDES)
        links.append(Link(f"{near}_top", f"{far}_top", conductance(CAST_IRON, 0.5, 2.1)))
        links.append(Link(f"{near}_base", f"{far}_base", conductance(CONCRETE, 2.1, 2.1)))
    for end, side in product(ENDS, SIDES):
        top, base = f"plate_{end}_{side}_top", f"plate_{end}_{side}_base"
        links += [Link(top, base, conductance(CONCRETE, BLOCK_M2, 0.4))]
        links += [Link(base, "floor", conductance(CONCRETE, BLOCK_M2 + 3.0, 0.6))]  # below and around
        links += [air(top, "enclosure", 3.0), Link(top, "coolant", 20.0, SPLASH)]
        links += [Link(top, f"wall_{side}_{end}_low_{face}", 6.0) for face in FACES]
        links.append(Link("workpiece", top, 12.0))
    return [*links, air("workpiece", "enclosure", 3.0), Link("workpiece", "coolant", 60.0, SPLASH)]


def _walls() -> list[Link]:
    links = []
    along, up, across = (conductance(WELDED, area, way) for area, way in ((0.06, 2.6), (0.07, 1.15), (0.04, 0.45)))
    for side in WALLS:
        for level, face in product(LEVELS, FACES):
            links.append(Link(f"wall_{side}_left_{level}_{face}", f"wall_{side}_right_{level}_{face}", along))
        for end in ENDS:
            wall = f"wall_{side}_{end}"
            links += [Link(f"{wall}_low_{face}", f"{wall}_high_{face}", up) for face in FACES]
            # Ribs, and what goes from plate to plate through the hollow: 5 W/m² K over 3 m² (chosen)
            links += [Link(f"{wall}_{level}_in", f"{wall}_{level}_out", across + 15.0) for level in LEVELS]
            links += [air(f"{wall}_{level}_in", "enclosure", 3.0) for level in LEVELS]
            links += [air(f"{wall}_low_out", HALL[side], 3.2)]
            links += [air(f"{wall}_high_out", there, 1.8) for there in (HALL[side], "air_high")]
    return links


def _bridge() -> list[Link]:
    links = []
    along = conductance(WELDED, 0.02, 1.5)
    for a, b in pairwise(PLACES):
        for layer, face in product(("top", "bottom"), ("left", "right")):
            links.append(Link(f"bridge_{a}_{layer}_{face}", f"bridge_{b}_{layer}_{face}", along))
    for place in PLACES:
        for layer in ("top", "bottom"):
            links.append(Link(f"bridge_{place}_{layer}_left", f"bridge_{place}_{layer}_right", 9.0))
        for face in ("left", "right"):
            top, bottom = f"bridge_{place}_top_{face}", f"bridge_{place}_bottom_{face}"
            links += [Link(top, bottom, 9.0), air(top, "air_high", 1.2)]
            links += [air(bottom, "enclosure", 0.8), air(bottom, "air_high", 0.4)]
    for side in SIDES:
        links += joined(f"guide_x_{side}", {f"bridge_{side}_bottom_{face}": 5.0 for face in ("left", "right")})
        links += joined(f"guide_x_{side}", {f"wall_{side}_{end}_high_{face}": 8.0 for end in ENDS for face in FACES})
        links.append(air(f"guide_x_{side}", "enclosure", 0.6))  # under bellows
    return links


def _carriage() -> list[Link]:
    links = []
    for part in (*SIDES, "back"):
        links.append(Link(f"carriage_low_{part}", f"carriage_high_{part}", conductance(CAST_IRON, 0.02, 0.8)))
    for level in LEVELS:
        around = "air_high" if level == "high" else "enclosure"
        for side in SIDES:
            here = f"carriage_{level}_{side}"
            links += [Link(here, f"carriage_{level}_back", 8.0), air(here, around, 0.9)]
            links += [Link(here, f"ram_{v}_{part}", 0.5) for v in LEVELS for part in (side, "right")]  # across a gap
        back = f"carriage_{level}_back"
        links += [Link("guide_z", back, 8.0), Link("guide_z", f"ram_{level}_left", 8.0), Link("guide_y", back, 6.0)]
    # By turns, over the stroke
    return links + joined("guide_y", {f"bridge_{p}_{layer}_right": 4.0 for p in PLACES for layer in ("top", "bottom")})


def _ram() -> list[Link]:
    links = spindle_links(
        front={"head": 24.0},
        rear={"head": 8.0, **{f"ram_low_{part}": 3.0 for part in (*SIDES, "left", "right")}},
        around="enclosure",
        to_chiller=(30.0, 20.0),
    )
    links += [Link("motor", "chiller", 75.0), Link("motor", "head", 10.0), Link("motor", "spindle_shaft", 3.0)]
    links += [air("head", "enclosure", 0.7), Link("head", "coolant", 6.0, SPLASH)]
    ring = ("near", "left", "far", "right")
    for part, beside in zip(ring, (*ring[1:], ring[0]), strict=True):
        low, high = f"ram_low_{part}", f"ram_high_{part}"
        links += [Link("head", low, 8.0), Link(low, high, conductance(WELDED, 0.012, 1.1))]
        links += [Link(f"ram_{level}_{part}", f"ram_{level}_{beside}", 6.0) for level in LEVELS]
        links += [air(low, "enclosure", 0.5), air(high, "air_high", 0.3)]
    links.append(Link("ram_high_left", "chiller", 3.0))  # its pipes run down there
    return links


def _drives() -> list[Link]:
    links = screw_links(
        SCREW_Z,
        ROD,
        mount={f"carriage_high_{part}": 2.5 for part in (*SIDES, "back")},
        nut={f"ram_high_{part}": 1.5 for part in (*SIDES, "left", "right")},
        around="air_high",
    )
    for side in WALLS:
        links += joined(f"motor_x_{side}", {f"bridge_{side}_{v}_left": 3.0 for v in ("top", "bottom")})
        links.append(air(f"motor_x_{side}", "air_high", 0.5))
    links += [
        *joined("motor_y", {"carriage_high_back": 4.0, "carriage_low_back": 2.0}),
        air("motor_y", "air_high", 0.5),
    ]
    return links


def _scales() -> list[Link]:
    """Return the scales' links: bellows keep them in still air; brackets hold them every 200 mm (chosen)."""
    links = []
    for scale, side in zip(SCALES_X, WALLS, strict=True):
        for node, ends in zip(scale.nodes, (("left",), ("left", "right"), ("right",)), strict=True):
            links.append(air(node, "enclosure", 0.6 * SCALE_GIRTH_M * 1.6))
            links += [Link(node, f"wall_{side}_{end}_high_in", 3.0 / len(ends)) for end in ends]
    for k, place in enumerate(PLACES):
        links.append(air(f"scale_y_{k}", "air_high", 0.6 * SCALE_GIRTH_M))
        links += [Link(f"scale_y_{k}", f"bridge_{place}_{layer}_right", 1.0) for layer in ("top", "bottom")]
    return links


def _capacities() -> dict[str, float]:
    nodes = steel(STEEL_KG) | iron(IRON_KG) | {name: capacity(WELDED, kg) for name, kg in WELDED_KG.items()}
    nodes |= {f"plate_{e}_{s}_base": capacity(CONCRETE, BLOCK_KG) for e in ENDS for s in SIDES}
    nodes |= screw_capacities(SCREW_Z, ROD)
    nodes |= {name: SCALE_J_PER_KG_K * SCALE_KG_PER_M * 1.6 for scale in SCALES_X for name in scale.nodes}
    nodes |= {f"scale_y_{k}": SCALE_J_PER_KG_K * SCALE_KG_PER_M * 1.0 for k in range(3)}
    return nodes | {
        "coolant": 1000.0 * COOLANT_J_PER_KG_K,  # a tank of 1000 l
        "enclosure": 3.5e5,  # 60 m³ of air and 600 kg of sheet metal
    }


def _spindle_sources() -> list[Source]:
    # Angular contact balls of 80 and 65 mm bore, oil and air: f0 = 1 (Harris and Kotzalas,
    # table of f0), ν = 12 mm²/s when warm.
    front = BearingFriction(2, 95.0, 1.0, 12.0, 40.0)
    rear = BearingFriction(2, 80.0, 1.0, 12.0, 25.0)
    motor = PowerLaw(1100.0, 15000.0, 1.2)  # iron and copper losses of a built-in motor of 30 kW
    return [
        SpindleSource(front, {"spindle_front": 0.65, "spindle_shaft": 0.35}, load_sensitivity=1.0),
        SpindleSource(rear, {"spindle_rear": 0.65, "spindle_shaft": 0.35}, load_sensitivity=0.3),
        SpindleSource(motor, {"motor": 0.88, "spindle_shaft": 0.12}, load_sensitivity=0.8),
        SpindleStartSource({"motor": 0.9, "spindle_shaft": 0.1}, inertia_kg_m2=0.06, lost=0.3),
    ]


def _axis_sources() -> list[Source]:
    rails_x = {f"guide_x_{side}": 0.5 for side in WALLS}
    motors_x = {f"motor_x_{side}": 0.5 for side in WALLS}
    return [
        # Rack and pinion: motors with their gears. Two of X, each with 400 N/A at the rack (2 N m/A, 1:10, a pinion
        # of 100 mm) and 0.4 ohm, lose as much as one with 400 N/A and 0.2 ohm.
        FeedSource("X", PowerLaw(420.0, FEED, 1.2), motors_x),
        FeedSource("X", PowerLaw(260.0, FEED, 1.0), rails_x),
        AccelerationSource("X", motors_x, 9000.0, 2.0, per_ampere=400.0, ohm=0.2, rapid_per_min=50000.0),
        FeedSource("Y", PowerLaw(240.0, FEED, 1.2), {"motor_y": 1.0}),
        FeedSource("Y", PowerLaw(120.0, FEED, 1.0), {"guide_y": 1.0}),
        AccelerationSource("Y", {"motor_y": 1.0}, 3800.0, 2.0, per_ampere=400.0, ohm=0.4, rapid_per_min=50000.0),
        *feed_sources(
            SCREW_Z,
            {"guide_z": 1.0},
            motor=PowerLaw(130.0, FEED, 1.3),
            nut=PowerLaw(130.0, FEED, 1.2),
            guide=PowerLaw(80.0, FEED, 1.0),
        ),
        # A motor of 1.6 N m/A on a lead of 20 mm gives 500 N/A.
        AccelerationSource("Z", {"motor_z": 1.0}, 1700.0, 3.0, per_ampere=500.0, ohm=0.6, rapid_per_min=40000.0),
        StandingSource({"motor_z": 1.0}, always_W=60.0),  # holds the ram
    ]


def _sources() -> tuple[Source, ...]:
    plate = {f"plate_{e}_{s}_top": 0.04 for e in ENDS for s in SIDES}
    return (
        *_spindle_sources(),
        *_axis_sources(),
        StandingSource({"wall_near_left_low_out": 0.7, "wall_near_left_low_in": 0.3}, always_W=150.0),  # hydraulics
        StandingSource({"coolant": 1.0}, coolant_W=900.0),  # pumps
        StandingSource({"coolant": 0.6, "enclosure": 0.1, "workpiece": 0.14, **plate}, load_W=1200.0),  # chips
    )


THERMOMETERS = {
    "spindle_front": Thermometer({"spindle_front": 0.8, "chiller": 0.2}, lag_s=40.0),
    "spindle_rear": Thermometer({"spindle_rear": 0.7, "head": 0.3}, lag_s=120.0),
    "motor": Thermometer({"motor": 1.0}, lag_s=60.0),
    "ram": Thermometer({"ram_low_near": 0.8, "ram_high_near": 0.2}, lag_s=60.0),
    "carriage": Thermometer({"carriage_high_far": 0.6, "carriage_low_far": 0.4}, lag_s=60.0),
    "bridge_top": Thermometer({"bridge_middle_top_left": 0.9, "air_high": 0.1}, lag_s=60.0),
    "bridge_bottom": Thermometer({"bridge_middle_bottom_left": 0.9, "enclosure": 0.1}, lag_s=60.0),
    "wall_near_low": Thermometer({"wall_near_left_low_out": 0.5, "wall_near_right_low_out": 0.5}, lag_s=60.0),
    "wall_near_high": Thermometer({"wall_near_left_high_in": 1.0}, lag_s=60.0),
    "wall_far_high": Thermometer({"wall_far_right_high_in": 1.0}, lag_s=60.0),
    "plate": Thermometer({"plate_left_near_top": 0.7, "plate_left_near_base": 0.3}, lag_s=60.0),
    "scale_x": Thermometer({"scale_x_near_1": 1.0}, lag_s=30.0),
    "scale_y": Thermometer({"scale_y_1": 1.0}, lag_s=30.0),
    "nut_z": Thermometer({"nut_z": 0.8, "ram_high_right": 0.2}, lag_s=60.0),
    "coolant": Thermometer({"coolant": 1.0}, lag_s=60.0),
    "ambient": Thermometer({"air_right": 1.0}, lag_s=180.0),
}

GANTRY3 = Design(
    name="gantry3",
    network=Network(
        _capacities(),
        BOUNDARIES,
        (
            *_plate(),
            *_walls(),
            *_bridge(),
            *_carriage(),
            *_ram(),
            *_drives(),
            *_scales(),
            # Curtains at both ends, open above.
            *hull_links({"air_left": 40.0, "air_right": 40.0, "air_high": 160.0}, tank_W_per_K=90.0),
        ),
    ),
    sources=_sources(),
    structure=STRUCTURE,
    thermometers=THERMOMETERS,
    workmanship=Workmanship(
        positioning_um=12.0,
        straightness_um=8.0,
        roll_urad=15.0,
        pitch_um=1.0,
        pitch_mm=20.0,
        location_um=10.0,
        without_screw=("X", "Y"),
    ),  # a large machine's, chosen
    layering=2.0,  # it reaches twice as high into the hall as a small machine
    capability=Capability(
        15000.0,
        {"X": 24000.0, "Y": 24000.0, "Z": 18000.0},
        {"X": (0.0, 4000.0), "Y": (0.0, 2500.0), "Z": (0.0, 1000.0)},
    ),
)
