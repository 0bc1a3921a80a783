"""Structure of `seed3`: a C frame on lined box ways. Dimensions [mm] are those of its class, chosen.

In the paper table and saddle move with their axes, not against them, and all frames coincide at coordinates 0: the
nose then stands over the table's far right corner and touches it. Its spindle has no terms of its own.
"""

from __future__ import annotations

from data_synth.c_frame_structure import ALPHA_STEEL, c_frame, screws
from data_synth.fields import SpeedShift
from data_synth.spindle import Spindle
from data_synth.supports import Foot

SIGNS = (1, 1)
NOSE_MM = 0.0
LINING_MM = 0.5  # 0.5 to 2 mm are usual (chosen)

# Screws: diameter 40 mm, each free at one end, as was usual before high speeds (chosen).
SCREWS = screws(SIGNS, NOSE_MM, held=0.0, stretch_K=0.0)

STRUCTURE = c_frame(
    SIGNS,
    NOSE_MM,
    SCREWS,
    Spindle(
        flange=Foot((0.0, 0.0, 180.0)),
        growth={"spindle_front": 100.0, "spindle_shaft": 80.0},
        expansion_per_K=ALPHA_STEEL,
        speed_shift=SpeedShift(um=2.0, at_rpm=6000.0),  # chosen
    ),
    LINING_MM,
)
