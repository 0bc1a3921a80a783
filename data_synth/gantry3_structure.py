"""Structure of `gantry3`: its parts' axes, sections, scales and screw. Dimensions [mm] are those of its class, chosen.

Frames as in the machine description: the bed's origin is the front left corner of the floor plate, x along the
walls, y along the bridge, z up. The near wall stands before the plate, the far wall behind it; left is small x. The
bridge has the carriage on its right face; the ram's left face runs in the carriage, its origin is the spindle nose.
As designed the machine is symmetric about the plane y = 1250 of the bed.

Walls and bridge are welded of plates, carriage and floor plate are cast, the ram is forged and welded steel. The floor
plate is grouted onto a block of concrete and deforms with it as one; both grow nearly alike.
"""

from __future__ import annotations

from itertools import product

from data_synth.assembly import Foot, Part, Structure
from data_synth.beam import Beam, Section
from data_synth.building_blocks import Rod
from data_synth.fields import SpeedShift
from data_synth.joints import Carriage, LinearJoint
from data_synth.materials import CAST_IRON, STEEL, Material
from data_synth.scale import Scale
from data_synth.screw import Screw
from data_synth.spindle import Spindle

WELDED = Material(12.0e-6, 440.0, 53.0)
"""Structural steel: 12e-6 (EN 1993-1-1, 3.2.6); 440 and 53.3 at 20 °C (EN 1993-1-2, 3.4.1)."""
CONCRETE = Material(10.0e-6, 900.0, 1.6)
"""10e-6 (EN 1992-1-1, 3.1.3); 900 and 1.4 to 2.0 at 20 °C (EN 1992-1-2, 3.3)."""
TAPE_PER_K = 11.5e-6
"""Stainless steel tape: makers state about 11e-6 (amosin.com, LMB-100); 4 m grow by 46 µm per degree."""

WALLS = {"near": -650.0, "far": 3150.0}  # y of their middle planes
ENDS = {"left": -1600.0, "right": 1600.0}  # along walls and plate, from the middle of the walls
WALL_MIDDLE, MIDDLE = 1700.0, 1250.0  # x of the walls' middle, y of the symmetry plane
RAIL_Z, BRIDGE_X = 2300.0, -450.0  # top of the walls; the bridge's middle at X = 0
PLACES = {"near": -1500.0, "middle": 0.0, "far": 1500.0}  # along the bridge

BLOCK_MM = 1400.0
"""Between top and base where the temperature runs straight. A day reaches some 0.15 m into concrete, √(a t / π), and
bends a block of 1.2 m as a straight course over 1.6 m would (6 δ / H²); the plate of iron on it bends more (chosen)."""

PLATE = Beam(
    origin_mm=(WALL_MIDDLE, MIDDLE, -BLOCK_MM / 2),
    along=(1.0, 0.0, 0.0),
    sections=tuple(
        Section(
            at,
            {
                f"plate_{end}_{side}_{layer}": (0.0, y, z)
                for (side, y), (layer, z) in product(
                    (("near", -1000.0), ("far", 1000.0)), (("top", BLOCK_MM / 2), ("base", -BLOCK_MM / 2))
                )
            },
        )
        for end, at in ENDS.items()
    ),
    expansion_per_K=CAST_IRON.expansion_per_K,
)


def _wall(side: str) -> Beam:
    """Return a wall, 2.3 m high and 0.5 m thick, with its inner face towards the plate."""
    inwards = 220.0 if side == "near" else -220.0
    return Beam(
        origin_mm=(WALL_MIDDLE, WALLS[side], 1150.0),
        along=(1.0, 0.0, 0.0),
        sections=tuple(
            Section(
                at,
                {
                    f"wall_{side}_{end}_{level}_{face}": (0.0, y, z)
                    for (level, z), (face, y) in product(
                        (("low", -650.0), ("high", 650.0)), (("in", inwards), ("out", -inwards))
                    )
                },
            )
            for end, at in ENDS.items()
        ),
        expansion_per_K=WELDED.expansion_per_K,
    )


BRIDGE = Beam(
    origin_mm=(BRIDGE_X, MIDDLE, 2700.0),
    along=(0.0, 1.0, 0.0),
    sections=tuple(
        Section(
            at,
            {
                f"bridge_{place}_{layer}_{face}": (x, 0.0, z)
                for (layer, z), (face, x) in product(
                    (("top", 400.0), ("bottom", -400.0)), (("left", -280.0), ("right", 280.0))
                )
            },
        )
        for place, at in PLACES.items()
    ),
    expansion_per_K=WELDED.expansion_per_K,
)
CARRIAGE = Beam(
    origin_mm=(0.0, 0.0, 2400.0),
    along=(0.0, 0.0, 1.0),
    sections=tuple(
        Section(
            at,
            {
                f"carriage_{level}_near": (50.0, -260.0, 0.0),
                f"carriage_{level}_far": (50.0, 260.0, 0.0),
                f"carriage_{level}_back": (-180.0, 0.0, 0.0),
            },
        )
        for level, at in (("low", -300.0), ("high", 500.0))
    ),
    expansion_per_K=CAST_IRON.expansion_per_K,
)
RAM = Beam(
    origin_mm=(0.0, 0.0, 0.0),
    along=(0.0, 0.0, 1.0),
    sections=(
        Section(150.0, {"head": (0.0, 0.0, 0.0)}),
        *(
            Section(
                at,
                {
                    f"ram_{level}_near": (0.0, -170.0, 0.0),
                    f"ram_{level}_far": (0.0, 170.0, 0.0),
                    f"ram_{level}_left": (-170.0, 0.0, 0.0),
                    f"ram_{level}_right": (170.0, 0.0, 0.0),
                },
            )
            for level, at in (("low", 600.0), ("high", 1700.0))
        ),
    ),
    expansion_per_K=STEEL.expansion_per_K,
)

# Scales of steel tape, held in the middle and free to both ends.
SCALES_X = tuple(
    Scale(
        axis="X",
        along=0,
        reader_at_zero_mm=BRIDGE_X,
        reader_sign=1,
        fixed_mm=WALL_MIDDLE,
        nodes=tuple(f"scale_x_{side}_{k}" for k in range(3)),
        edges_mm=(-700.0, 900.0, 2500.0, 4100.0),
        expansion_per_K=TAPE_PER_K,
        on=f"wall_{side}",
    )
    for side in WALLS
)
SCALE_Y = Scale(
    axis="Y",
    along=1,
    reader_at_zero_mm=0.0,
    reader_sign=1,
    fixed_mm=MIDDLE,
    nodes=tuple(f"scale_y_{k}" for k in range(3)),
    edges_mm=(-250.0, 750.0, 1750.0, 2750.0),
    expansion_per_K=TAPE_PER_K,
)

# A screw of 50 mm hangs in the carriage from its fixed bearing, the nut on the ram.
ROD = Rod(50.0)
SCREW_Z = Screw(
    axis="Z",
    along=2,
    nut_at_zero_mm=2250.0,
    nut_sign=1,
    fixed_mm=3500.0,
    far_mm=2100.0,
    nodes=tuple(f"screw_z_{k}" for k in range(4)),
    edges_mm=(2100.0, 2450.0, 2800.0, 3150.0, 3500.0),
    expansion_per_K=STEEL.expansion_per_K,
)

SEAT = Foot((2000.0, MIDDLE, 0.0), on="plate")
"""Workpieces are clamped about the plate's middle; the workpiece frame rides there, so nothing else is at rest."""

STRUCTURE = Structure(
    bodies={
        "bed": {
            "plate": Part(PLATE),
            # Bolted along their length: the ends decide how a wall leans and turns.
            **{
                f"wall_{side}": Part(
                    _wall(side),
                    feet=tuple(Foot((WALL_MIDDLE + at, y, 0.0), on="plate") for at in (-2000.0, 2000.0)),
                )
                for side, y in WALLS.items()
            },
        },
        "X": {"bridge": Part(BRIDGE)},
        "Y": {"carriage": Part(CARRIAGE)},
        "Z": {"ram": Part(RAM)},
    },
    ground=SEAT,
    workpiece=SEAT,
    joints={
        # Both walls are as stiff, so neither leads the bridge across.
        "X": LinearJoint(
            tuple(Carriage((BRIDGE_X, y, RAIL_Z), on=f"wall_{side}") for side, y in WALLS.items()), SCALES_X
        ),
        "Y": LinearJoint((Carriage((-130.0, 0.0, 2700.0)),), (SCALE_Y,)),
        "Z": LinearJoint((Carriage((-200.0, 0.0, 2000.0)), Carriage((-200.0, 0.0, 2800.0))), (SCREW_Z,), rail="body"),
    },
    spindle=Spindle(
        flange=Foot((0.0, 0.0, 220.0)),
        growth={"spindle_front": 120.0, "spindle_shaft": 100.0},
        expansion_per_K=STEEL.expansion_per_K,
        speed_shift=SpeedShift(um=4.0, at_rpm=15000.0),  # chosen
    ),
)
