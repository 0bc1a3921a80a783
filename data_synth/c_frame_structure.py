"""Structure of a vertical machine with a C frame: table X on saddle Y on the bed, head Z on the column.

x to the right, y to the column, z up; the bed's origin is on the spindle axis. The machine is symmetric about the
plane x = 0 of the bed. Dimensions [mm] are those of machines of 800 x 500 x 500 mm, chosen.
"""

from __future__ import annotations

from collections.abc import Mapping

from data_synth.assembly import Foot, Part, Structure
from data_synth.beam import Beam, Section, Vector
from data_synth.joints import Carriage, Connection, LinearJoint
from data_synth.materials import CAST_IRON, LINING_PER_K, STEEL
from data_synth.screw import Screw
from data_synth.spindle import Spindle

ALPHA_IRON, ALPHA_STEEL = CAST_IRON.expansion_per_K, STEEL.expansion_per_K
HALF_X, HALF_Y = 400.0, 250.0  # of the strokes: at coordinate 0 table and saddle are that far from the middle

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
SADDLE_GUIDE: dict[str, Vector] = {
    f"saddle_{side}_{end}": (x, y, 0.0)
    for side, x in (("left", -350.0), ("right", 350.0))
    for end, y in (("front", -220.0), ("rear", 220.0))
}
HEAD_GUIDE: dict[str, Vector] = {
    "head_rear_left": (-180.0, 0.0, 0.0),
    "head_rear_right": (180.0, 0.0, 0.0),
    "head_front_low": (0.0, 0.0, -150.0),
}


def screws(signs: tuple[int, int], nose_mm: float, held: float, stretch_K: float) -> tuple[Screw, Screw, Screw]:
    """Return the screws of X (held by the saddle), Y (by the bed) and Z (by the column), four nodes each.

    X and Y are held at both ends and stretched, where `stretch_K` says so; Z is free at its lower end.

    Parameters
    ----------
    signs : of the directions in which table and saddle move
    nose_mm : height of the spindle's nose over the table at Z = 0
    """
    parts = {
        "X": (0, -signs[0] * HALF_X, signs[0], 620.0, -620.0, held, stretch_K),
        "Y": (1, -signs[1] * HALF_Y, signs[1], 480.0, -480.0, held, stretch_K),
        "Z": (2, nose_mm + 250.0, 1, nose_mm + 1000.0, nose_mm + 100.0, 0.0, 0.0),
    }
    made = []
    for axis, (along, zero, sign, fixed, far, share, stretch) in parts.items():
        piece = (fixed - far) / 4
        made.append(
            Screw(
                axis=axis,
                along=along,
                nut_at_zero_mm=zero,
                nut_sign=sign,
                fixed_mm=fixed,
                far_mm=far,
                nodes=tuple(f"screw_{axis.lower()}_{k}" for k in range(4)),
                edges_mm=tuple(far + piece * k for k in range(5)),
                expansion_per_K=ALPHA_STEEL,
                held=share,
                stretch_K=stretch,
            )
        )
    return (made[0], made[1], made[2])


def c_frame(
    signs: tuple[int, int],
    nose_mm: float,
    screws: tuple[Screw, Screw, Screw],
    spindle: Spindle,
    lining_mm: float = 0.0,
) -> Structure:
    """Return the structure; `lining_mm` is the thickness of what its slideways are lined with, if they are."""
    x, y = -signs[0] * HALF_X, -signs[1] * HALF_Y  # middles of table and saddle in their own frames
    saddle = Beam(
        origin_mm=(0.0, y, -180.0),
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
    table = Beam(
        origin_mm=(x, y, -60.0),
        along=(0.0, 0.0, 1.0),
        sections=(Section(0.0, {"table_left": (-250.0, 0.0, 0.0), "table_right": (250.0, 0.0, 0.0)}),),
        expansion_per_K=ALPHA_IRON,
    )
    on_saddle, on_bed, on_column = (x, y, -120.0), (0.0, y, -250.0), (0.0, 450.0, 250.0)
    lined = {}
    if lining_mm:
        lined = {
            "X": _lining(on_saddle, 2, SADDLE_GUIDE, lining_mm),
            "Y": _lining(on_bed, 2, SADDLE_GUIDE, lining_mm),
            "Z": _lining(on_column, 1, HEAD_GUIDE, lining_mm),
        }
    return Structure(
        bodies={
            "bed": {"bed": Part(BED), "column": Part(COLUMN, (Foot((0.0, 700.0, -250.0), on="bed"),))},
            "Y": {"saddle": Part(saddle)},
            "X": {"table": Part(table)},
            "Z": {"head": Part(HEAD)},
        },
        ground=Foot((0.0, 0.0, -850.0)),
        joints={
            "X": LinearJoint((Carriage(on_saddle),), (screws[0],), connection=lined.get("X")),
            "Y": LinearJoint((Carriage(on_bed),), (screws[1],), connection=lined.get("Y")),
            "Z": LinearJoint(
                (Carriage((0.0, 450.0, nose_mm + 250.0), on="column"),), (screws[2],), connection=lined.get("Z")
            ),
        },
        spindle=spindle,
    )


def _lining(at_mm: Vector, normal: int, nodes: Mapping[str, Vector], thickness_mm: float) -> Connection:
    """Return a slideway's lining: as thick under the slide as beside it and at the nut's seat."""
    x, y, z = at_mm
    along = (float(normal == 0), float(normal == 1), float(normal == 2))
    beam = Beam(at_mm, along, (Section(0.0, nodes),), LINING_PER_K)
    return Connection(beam, (x - thickness_mm, y - thickness_mm, z - thickness_mm), at_mm)
