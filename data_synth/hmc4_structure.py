"""Structure of `hmc4`: its parts' axes, sections and screws. Dimensions [mm] are those of its class, chosen.

Frames as in the machine description: x to the right, y up, z along the spindle, out of the pallet and into the
head. The bed is a T: its stem carries the table, its cross piece the column. The machine is symmetric about the
plane x = 0 but for the drive of X.
"""

from __future__ import annotations

from data_synth.angle import Worm
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

# Screws of 50 mm; X and Z held at both ends and stretched, Y free at its lower end. Held share 0.5: bearings of
# 1000 N/µm beside a screw of 280 N/µm leave 0.65, housings give way (chosen).
ROD = Rod(50.0)
SCREW_X = Screw(
    axis="X",
    along=0,
    nut_at_zero_mm=0.0,
    nut_sign=1,
    fixed_mm=750.0,
    far_mm=-750.0,
    nodes=tuple(f"screw_x_{k}" for k in range(5)),
    edges_mm=(-750.0, -450.0, -150.0, 150.0, 450.0, 750.0),
    expansion_per_K=ALPHA_STEEL,
    held=0.5,
    stretch_K=3.0,
    on="cross",
)
SCREW_Y = Screw(
    axis="Y",
    along=1,
    nut_at_zero_mm=0.0,
    nut_sign=1,
    fixed_mm=1000.0,
    far_mm=-200.0,
    nodes=tuple(f"screw_y_{k}" for k in range(4)),
    edges_mm=(-200.0, 100.0, 400.0, 700.0, 1000.0),
    expansion_per_K=ALPHA_STEEL,
)
SCREW_Z = Screw(
    axis="Z",
    along=2,
    nut_at_zero_mm=-150.0,
    nut_sign=-1,
    fixed_mm=100.0,
    far_mm=-1100.0,
    nodes=tuple(f"screw_z_{k}" for k in range(4)),
    edges_mm=(-1100.0, -800.0, -500.0, -200.0, 100.0),
    expansion_per_K=ALPHA_STEEL,
    held=0.5,
    stretch_K=3.0,
    on="stem",
)
SCREWS = (SCREW_X, SCREW_Y, SCREW_Z)

STEM = Beam(
    origin_mm=(0.0, -750.0, 0.0),
    along=(0.0, 0.0, 1.0),
    sections=tuple(
        Section(
            at,
            {
                f"bed_stem_{end}_left": (-330.0, 150.0, 0.0),
                f"bed_stem_{end}_right": (330.0, 150.0, 0.0),
                f"bed_stem_{end}_base": (0.0, -230.0, 0.0),
            },
        )
        for end, at in (("front", -900.0), ("rear", 0.0))
    ),
    expansion_per_K=ALPHA_IRON,
)
CROSS = Beam(
    origin_mm=(0.0, -700.0, 550.0),
    along=(1.0, 0.0, 0.0),
    sections=tuple(
        Section(
            at,
            {
                f"bed_cross_{side}_front": (0.0, 180.0, -220.0),
                f"bed_cross_{side}_rear": (0.0, 180.0, 220.0),
                f"bed_cross_{side}_base": (0.0, -280.0, 0.0),
            },
        )
        for side, at in (("left", -500.0), ("right", 500.0))
    ),
    expansion_per_K=ALPHA_IRON,
)
COLUMN = Beam(
    origin_mm=(0.0, 0.0, 550.0),
    along=(0.0, 1.0, 0.0),
    sections=tuple(
        Section(
            at,
            {
                f"column_{level}_front_left": (-350.0, 0.0, -200.0),
                f"column_{level}_front_right": (350.0, 0.0, -200.0),
                f"column_{level}_rear_left": (-350.0, 0.0, 200.0),
                f"column_{level}_rear_right": (350.0, 0.0, 200.0),
            },
        )
        for level, at in (("lower", 0.0), ("upper", 900.0))
    ),
    expansion_per_K=ALPHA_IRON,
)
# The head's middle is above the spindle, which has to come down to the pallet: off the middle of a box that is warm on
# one side, it also twists.
HEAD = Beam(
    origin_mm=(0.0, 30.0, 0.0),
    along=(0.0, 0.0, 1.0),
    sections=(
        Section(
            160.0,
            {
                "head_front_lower_left": (-140.0, -140.0, 0.0),
                "head_front_lower_right": (140.0, -140.0, 0.0),
                "head_front_upper_left": (-140.0, 140.0, 0.0),
                "head_front_upper_right": (140.0, 140.0, 0.0),
            },
        ),
        Section(480.0, {"head_rear_left": (-200.0, 0.0, 0.0), "head_rear_right": (200.0, 0.0, 0.0)}),
    ),
    expansion_per_K=ALPHA_IRON,
)
SADDLE = Beam(
    origin_mm=(0.0, -430.0, 0.0),
    along=(0.0, 1.0, 0.0),
    sections=(
        Section(
            0.0,
            {
                "saddle_front_left": (-320.0, 0.0, -260.0),
                "saddle_front_right": (320.0, 0.0, -260.0),
                "saddle_rear_left": (-320.0, 0.0, 260.0),
                "saddle_rear_right": (320.0, 0.0, 260.0),
            },
        ),
    ),
    expansion_per_K=ALPHA_IRON,
)
TABLE = Beam(
    origin_mm=(0.0, -230.0, 0.0),
    along=(0.0, 1.0, 0.0),
    sections=(Section(0.0, {"table": (0.0, 0.0, 0.0)}),),
    expansion_per_K=ALPHA_IRON,
)
PALLET = Beam(
    origin_mm=(0.0, -60.0, 0.0),
    along=(0.0, 1.0, 0.0),
    sections=(
        Section(
            0.0,
            {
                "pallet_front_left": (-210.0, 0.0, -210.0),
                "pallet_front_right": (210.0, 0.0, -210.0),
                "pallet_rear_left": (-210.0, 0.0, 210.0),
                "pallet_rear_right": (210.0, 0.0, 210.0),
            },
        ),
    ),
    expansion_per_K=ALPHA_IRON,
)
STRUCTURE = Structure(
    bodies={
        "bed": {"cross": Part(CROSS), "stem": Part(STEM, feet=(Foot((0.0, -700.0, 300.0), on="cross"),))},
        "X": {"column": Part(COLUMN)},
        "Y": {"head": Part(HEAD)},
        "Z": {"saddle": Part(SADDLE)},
        "B": {"table": Part(TABLE), "pallet": Part(PALLET, feet=(Foot((0.0, -130.0, 0.0), on="table"),))},
    },
    ground=Foot((0.0, -1050.0, 550.0), on="cross"),
    joints={
        "X": LinearJoint((Carriage((0.0, -400.0, 550.0), on="cross"),), (SCREW_X,)),
        "Y": LinearJoint((Carriage((0.0, 0.0, 330.0)),), (SCREW_Y,)),
        "Z": LinearJoint((Carriage((0.0, -550.0, -150.0), on="stem"),), (SCREW_Z,)),
        # A worm at the front of its wheel; the bearing's ring of 50 mm takes the place of as much of the saddle.
        "B": RotaryJoint(
            (Carriage((0.0, -320.0, 0.0)),),
            growth={
                "bearing_b": (0.0, 50.0, 0.0),
                **{
                    f"saddle_{end}_{side}": (0.0, -12.5, 0.0) for end in ("front", "rear") for side in ("left", "right")
                },
            },
            angle=Worm(
                disc_mm=(0.0, -330.0, 0.0),
                radius_mm=180.0,
                tangent=(1.0, 0.0, 0.0),
                wheel={"worm_b": 0.5, "table": 0.5},
                housing={"saddle_front_left": 0.5, "saddle_front_right": 0.5},
                centre_mm=240.0,
            ),
            races=(
                Race(
                    420.0,
                    turning={"bearing_b": 1.0},
                    standing={f"saddle_{end}_{side}": 0.25 for end in ("front", "rear") for side in ("left", "right")},
                    phase_degree=80.0,
                ),
            ),
        ),
    },
    spindle=Spindle(
        flange=Foot((0.0, 0.0, 170.0)),
        growth={"spindle_front": 90.0, "spindle_shaft": 80.0},
        expansion_per_K=ALPHA_STEEL,
        speed_shift=SpeedShift(um=5.0, at_rpm=10000.0),  # chosen
    ),
    workpiece=Foot((0.0, 0.0, 0.0), on="pallet"),
)
