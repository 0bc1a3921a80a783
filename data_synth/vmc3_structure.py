"""Structure of `vmc3`: a C frame on rolling guides. Dimensions [mm] are those of its class, chosen."""

from __future__ import annotations

from data_synth.c_frame_structure import ALPHA_STEEL, c_frame, screws
from data_synth.fields import SpeedShift
from data_synth.spindle import Spindle
from data_synth.supports import Foot

SIGNS = (-1, -1)  # ISO 841: table and saddle move against their axes
NOSE_MM = 150.0

# Screws: diameter 40 mm; X and Y held at both ends and stretched.
# Held share 0.5: bearings of 800 N/µm beside a screw of 220 N/µm leave 0.65, housings give way (chosen).
SCREWS = screws(SIGNS, NOSE_MM, held=0.5, stretch_K=3.0)
SCREW_X, SCREW_Y, SCREW_Z = SCREWS

STRUCTURE = c_frame(
    SIGNS,
    NOSE_MM,
    SCREWS,
    Spindle(
        flange=Foot((0.0, 0.0, 180.0)),
        growth={"spindle_front": 100.0, "spindle_shaft": 80.0},
        expansion_per_K=ALPHA_STEEL,
        speed_shift=SpeedShift(um=4.0, at_rpm=12000.0),  # chosen
    ),
)
