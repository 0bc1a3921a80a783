"""Structure of `vmc3`: its parts' axes, sections and screws. Dimensions [mm] are those of its class, chosen."""

from __future__ import annotations

from data_synth.beam import Beam, Section
from data_synth.cframe import CFrame
from data_synth.fields import SpeedShift
from data_synth.materials import CAST_IRON, STEEL
from data_synth.screw import Screw

ALPHA_IRON, ALPHA_STEEL = CAST_IRON.expansion_per_K, STEEL.expansion_per_K

# Screws: diameter 40 mm, four nodes each; X and Y held at both ends and stretched, Z free at its lower end.
# Held share 0.5: bearings of 800 N/µm beside a screw of 220 N/µm leave 0.65, housings give way (chosen).
SCREW_X = Screw(
    axis=0,
    nut_at_zero_mm=400.0,
    nut_sign=-1,
    fixed_mm=620.0,
    far_mm=-620.0,
    nodes=("screw_x_0", "screw_x_1", "screw_x_2", "screw_x_3"),
    edges_mm=(-620.0, -310.0, 0.0, 310.0, 620.0),
    expansion_per_K=ALPHA_STEEL,
    held=0.5,
    stretch_K=3.0,
)
SCREW_Y = Screw(
    axis=1,
    nut_at_zero_mm=250.0,
    nut_sign=-1,
    fixed_mm=480.0,
    far_mm=-480.0,
    nodes=("screw_y_0", "screw_y_1", "screw_y_2", "screw_y_3"),
    edges_mm=(-480.0, -240.0, 0.0, 240.0, 480.0),
    expansion_per_K=ALPHA_STEEL,
    held=0.5,
    stretch_K=3.0,
)
SCREW_Z = Screw(
    axis=2,
    nut_at_zero_mm=400.0,
    nut_sign=1,
    fixed_mm=1150.0,
    far_mm=250.0,
    nodes=("screw_z_0", "screw_z_1", "screw_z_2", "screw_z_3"),
    edges_mm=(250.0, 475.0, 700.0, 925.0, 1150.0),
    expansion_per_K=ALPHA_STEEL,
)
SCREWS = (SCREW_X, SCREW_Y, SCREW_Z)

BED = Beam(
    origin_mm=(0.0, 0.0, -550.0),
    along=(0.0, 1.0, 0.0),
    sections=tuple(
        Section(
            at,
            {
                f"bed_{part}_left": (-280.0, 0.0, 180.0),
                f"bed_{part}_right": (280.0, 0.0, 180.0),
                f"bed_{part}_base": (0.0, 0.0, -220.0),
            },
        )
        for part, at in (("front", -350.0), ("rear", 550.0))
    ),
    expansion_per_K=ALPHA_IRON,
)
COLUMN = Beam(
    origin_mm=(0.0, 700.0, 0.0),
    along=(0.0, 0.0, 1.0),
    sections=tuple(
        Section(
            at,
            {
                f"column_{part}_left": (-250.0, -150.0, 0.0),
                f"column_{part}_right": (250.0, -150.0, 0.0),
                f"column_{part}_rear": (0.0, 220.0, 0.0),
            },
        )
        for part, at in (("lower", 150.0), ("upper", 850.0))
    ),
    expansion_per_K=ALPHA_IRON,
)
SADDLE = Beam(
    origin_mm=(0.0, 250.0, -180.0),
    along=(1.0, 0.0, 0.0),
    sections=tuple(
        Section(
            at,
            {
                f"saddle_{part}_front": (0.0, -220.0, 40.0),
                f"saddle_{part}_rear": (0.0, 220.0, 40.0),
                f"saddle_{part}_base": (0.0, 0.0, -60.0),
            },
        )
        for part, at in (("left", -350.0), ("right", 350.0))
    ),
    expansion_per_K=ALPHA_IRON,
)
TABLE = Beam(
    origin_mm=(400.0, 250.0, -60.0),
    along=(0.0, 0.0, 1.0),
    sections=(Section(0.0, {"table_left": (-250.0, 0.0, 0.0), "table_right": (250.0, 0.0, 0.0)}),),
    expansion_per_K=ALPHA_IRON,
)
HEAD = Beam(
    origin_mm=(0.0, 0.0, 250.0),
    along=(0.0, 1.0, 0.0),
    sections=(
        Section(
            50.0,
            {
                "head_front_low": (0.0, 0.0, -150.0),
                "head_front_left": (-150.0, 0.0, 150.0),
                "head_front_right": (150.0, 0.0, 150.0),
            },
        ),
        Section(330.0, {"head_rear_left": (-180.0, 0.0, 0.0), "head_rear_right": (180.0, 0.0, 0.0)}),
    ),
    expansion_per_K=ALPHA_IRON,
)
STRUCTURE = CFrame(
    bed=BED,
    column=COLUMN,
    saddle=SADDLE,
    table=TABLE,
    head=HEAD,
    bed_anchor=(0.0, 0.0, -850.0),
    column_foot=(0.0, 700.0, -250.0),
    saddle_carriage=(0.0, 250.0, -250.0),
    table_carriage=(400.0, 250.0, -120.0),
    head_carriage=(0.0, 450.0, 400.0),
    saddle_lever=(0.0, -250.0, 250.0),
    table_lever=(-400.0, -250.0, 120.0),
    head_lever=(0.0, -450.0, -250.0),
    screws=SCREWS,
    flange=(0.0, 0.0, 180.0),
    spindle={"spindle_front": 100.0, "spindle_shaft": 80.0},
    spindle_expansion_per_K=ALPHA_STEEL,
    speed_shift=SpeedShift(um=-4.0, at_rpm=12000.0),  # chosen
)
