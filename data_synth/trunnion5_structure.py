"""Structure of `trunnion5`: its parts' axes, sections and screws. Dimensions [mm] are those of its class, chosen.

Frames as in the machine description: x to the right, y to the rear, z up; the bed's origin is the middle of the
table's top. The bed is a trough; the cradle hangs between its walls, the portal runs on them. The machine is
symmetric about the plane x = 0, but the cradle has its fixed bearing and its encoder at the left.
"""

from __future__ import annotations

from data_synth.angle import Encoder
from data_synth.assembly import Foot, Part, Structure
from data_synth.beam import Beam, Section
from data_synth.building_blocks import Rod
from data_synth.fields import SpeedShift
from data_synth.joints import Carriage, LinearJoint, RotaryJoint
from data_synth.materials import CAST_IRON, STEEL
from data_synth.race import Race
from data_synth.screw import Screw
from data_synth.spindle import Spindle

ALPHA_IRON, ALPHA_STEEL = CAST_IRON.expansion_per_K, STEEL.expansion_per_K

# Screws of 40 mm; X and Y held at both ends and stretched, Z free at its lower end. Held share 0.5: bearings of
# 800 N/µm beside a screw of 220 N/µm leave 0.65, housings give way (chosen). Y has one screw on each wall; they do
# the same and count as one.
RODS = (Rod(40.0), Rod(40.0, number=2), Rod(40.0))
SCREW_X = Screw(
    axis="X",
    along=0,
    nut_at_zero_mm=0.0,
    nut_sign=1,
    fixed_mm=640.0,
    far_mm=-640.0,
    nodes=tuple(f"screw_x_{k}" for k in range(4)),
    edges_mm=(-640.0, -320.0, 0.0, 320.0, 640.0),
    expansion_per_K=ALPHA_STEEL,
    held=0.5,
    stretch_K=3.0,
)
SCREW_Y = Screw(
    axis="Y",
    along=1,
    nut_at_zero_mm=350.0,
    nut_sign=1,
    fixed_mm=900.0,
    far_mm=-200.0,
    nodes=tuple(f"screw_y_{k}" for k in range(4)),
    edges_mm=(-200.0, 75.0, 350.0, 625.0, 900.0),
    expansion_per_K=ALPHA_STEEL,
    held=0.5,
    stretch_K=3.0,
    line_mm=(0.0, 400.0, 450.0),  # the middle between the two
)
SCREW_Z = Screw(
    axis="Z",
    along=2,
    nut_at_zero_mm=700.0,
    nut_sign=1,
    fixed_mm=1380.0,
    far_mm=580.0,
    nodes=tuple(f"screw_z_{k}" for k in range(4)),
    edges_mm=(580.0, 780.0, 980.0, 1180.0, 1380.0),
    expansion_per_K=ALPHA_STEEL,
)
SCREWS = (SCREW_X, SCREW_Y, SCREW_Z)

BED = Beam(
    origin_mm=(0.0, 0.0, -350.0),
    along=(0.0, 1.0, 0.0),
    sections=tuple(
        Section(
            at,
            {
                f"bed_{end}_left": (-700.0, 0.0, 350.0),
                f"bed_{end}_right": (700.0, 0.0, 350.0),
                f"bed_{end}_base": (0.0, 0.0, -330.0),
            },
        )
        for end, at in (("front", -450.0), ("rear", 550.0))
    ),
    expansion_per_K=ALPHA_IRON,
)
PORTAL = Beam(
    origin_mm=(0.0, 400.0, 850.0),
    along=(1.0, 0.0, 0.0),
    sections=tuple(
        Section(
            at,
            {
                f"portal_{side}_low": (0.0, -130.0, -170.0),
                f"portal_{side}_high": (0.0, -130.0, 170.0),
                f"portal_{side}_rear": (0.0, 170.0, 0.0),
            },
        )
        for side, at in (("left", -450.0), ("right", 450.0))
    ),
    expansion_per_K=ALPHA_IRON,
)
SLIDE = Beam(
    origin_mm=(0.0, 150.0, 850.0),
    along=(0.0, 0.0, 1.0),
    sections=tuple(
        Section(at, {f"slide_{level}_left": (-180.0, 0.0, 0.0), f"slide_{level}_right": (180.0, 0.0, 0.0)})
        for level, at in (("low", -180.0), ("high", 180.0))
    ),
    expansion_per_K=ALPHA_IRON,
)
RAM = Beam(
    origin_mm=(0.0, 0.0, 0.0),
    along=(0.0, 0.0, 1.0),
    sections=tuple(
        Section(
            at,
            {
                f"ram_{level}_left": (-110.0, -50.0, 0.0),
                f"ram_{level}_right": (110.0, -50.0, 0.0),
                f"ram_{level}_rear": (0.0, 100.0, 0.0),
            },
        )
        for level, at in (("low", 200.0), ("high", 700.0))
    ),
    expansion_per_K=ALPHA_IRON,
)
CRADLE = Beam(
    origin_mm=(0.0, 0.0, -220.0),
    along=(1.0, 0.0, 0.0),
    sections=tuple(
        Section(
            at,
            {
                f"cradle_{side}_arm": (0.0, 0.0, 130.0),
                f"cradle_{side}_front": (0.0, -170.0, -65.0),
                f"cradle_{side}_rear": (0.0, 170.0, -65.0),
            },
        )
        for side, at in (("left", -330.0), ("right", 330.0))
    ),
    expansion_per_K=ALPHA_IRON,
)
TABLE = Beam(
    origin_mm=(0.0, 0.0, -70.0),
    along=(0.0, 0.0, 1.0),
    sections=(
        Section(
            0.0,
            {
                "table_left": (-170.0, 0.0, 0.0),
                "table_right": (170.0, 0.0, 0.0),
                "table_front": (0.0, -170.0, 0.0),
                "table_rear": (0.0, 170.0, 0.0),
            },
        ),
    ),
    expansion_per_K=ALPHA_IRON,
)
STRUCTURE = Structure(
    bodies={
        "bed": {"bed": Part(BED)},
        "Y": {"portal": Part(PORTAL)},
        "X": {"slide": Part(SLIDE)},
        "Z": {"ram": Part(RAM)},
        "A": {"cradle": Part(CRADLE)},
        "C": {"table": Part(TABLE)},
    },
    ground=Foot((0.0, 150.0, -750.0)),
    joints={
        "Y": LinearJoint((Carriage((-750.0, 400.0, 450.0)), Carriage((750.0, 400.0, 450.0))), (SCREW_Y,)),
        "X": LinearJoint((Carriage((0.0, 220.0, 850.0)),), (SCREW_X,)),
        "Z": LinearJoint((Carriage((0.0, 110.0, 800.0)),), (SCREW_Z,), rail="body"),
        # Rings and seats of 30 mm at both ends lift the cradle's line, its middle by half of each; and a ring of 60 mm
        # lifts the table. They take the place of as much iron.
        "A": RotaryJoint(
            (Carriage((-520.0, 0.0, 60.0), hold=1.0), Carriage((520.0, 0.0, 60.0), hold=0.0)),
            growth={
                **{f"bearing_a_{side}": (0.0, 0.0, 15.0) for side in ("left", "right")},
                **{f"bed_{end}_{side}": (0.0, 0.0, -7.5) for end in ("front", "rear") for side in ("left", "right")},
            },
            angle=Encoder(disc_mm=(-530.0, 0.0, 0.0), radius_mm=130.0, tangent=(0.0, 0.0, 1.0)),
            races=tuple(
                Race(
                    260.0,
                    turning={f"bearing_a_{side}": 1.0},
                    standing={f"bed_{end}_{side}": 0.5 for end in ("front", "rear")},
                    phase_degree=phase,
                )
                for side, phase in (("left", 50.0), ("right", 170.0))
            ),
        ),
        "C": RotaryJoint(
            (Carriage((0.0, 0.0, -200.0)),),
            growth={
                "bearing_c": (0.0, 0.0, 35.0),
                "motor_c": (0.0, 0.0, 25.0),
                **{
                    f"cradle_{side}_{end}": (0.0, 0.0, -15.0) for side in ("left", "right") for end in ("front", "rear")
                },
            },
            angle=Encoder(disc_mm=(0.0, 0.0, -160.0), radius_mm=120.0, tangent=(1.0, 0.0, 0.0)),
            races=(
                Race(
                    325.0,
                    turning={"bearing_c": 1.0},
                    standing={f"cradle_{side}_{end}": 0.25 for side in ("left", "right") for end in ("front", "rear")},
                    phase_degree=65.0,
                ),
            ),
        ),
    },
    spindle=Spindle(
        flange=Foot((0.0, 0.0, 120.0)),
        growth={"spindle_front": 65.0, "spindle_shaft": 55.0},
        expansion_per_K=ALPHA_STEEL,
        speed_shift=SpeedShift(um=6.0, at_rpm=18000.0),  # chosen
    ),
    workpiece=Foot((0.0, 0.0, 0.0)),
)
