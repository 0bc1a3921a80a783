"""Thermal design of `seed3`, the machine of Su, Li and Wang (2001): a C-frame machine of that time.

The paper gives neither size nor speed. Chosen: 6000 rpm on grease without a chiller, box ways, 6 m/min.
"""

from __future__ import annotations

from data_synth.c_frame import Figures, design
from data_synth.capability import Capability
from data_synth.heat import BearingFriction, PowerLaw
from data_synth.seed3_structure import SCREWS, STRUCTURE
from data_synth.sensors import Thermometer

THERMOMETERS = {
    "spindle_front": Thermometer({"spindle_front": 0.8, "head_front_low": 0.2}, lag_s=60.0),
    "head": Thermometer({"head_front_low": 0.7, "head_rear_left": 0.3}, lag_s=60.0),
    "column_front": Thermometer({"column_upper_left": 0.8, "column_lower_left": 0.2}, lag_s=60.0),
    "column_rear": Thermometer({"column_lower_rear": 0.6, "column_upper_rear": 0.4}, lag_s=60.0),
    "bed": Thermometer({"bed_front_left": 1.0}, lag_s=60.0),
    "saddle": Thermometer({"saddle_right_front": 0.6, "saddle_left_base": 0.4}, lag_s=60.0),
    "nut_x": Thermometer({"nut_x": 0.8, "table_right": 0.2}, lag_s=60.0),
    "nut_y": Thermometer({"nut_y": 0.8, "saddle_left_base": 0.2}, lag_s=60.0),
    "nut_z": Thermometer({"nut_z": 0.8, "head_rear_right": 0.2}, lag_s=60.0),
    "ambient": Thermometer({"air_right": 1.0}, lag_s=180.0),
}

SEED3 = design(
    Figures(
        name="seed3",
        structure=STRUCTURE,
        screws=SCREWS,
        # Angular contact balls of 70 and 60 mm bore on grease: f0 = 1.5 after running in (Harris and Kotzalas,
        # table of f0), ν = 12 mm²/s when warm.
        front=BearingFriction(2, 90.0, 1.5, 12.0, 40.0),
        rear=BearingFriction(2, 78.0, 1.5, 12.0, 30.0),
        motor=PowerLaw(350.0, 6000.0, 1.2),  # losses of 7.5 kW
        to_chiller=(0.0, 0.0, 0.0),
        guides=PowerLaw(90.0, 10000.0, 1.0),  # lined ways rub more than rolling guides
        moved_kg=(1900.0, 2400.0, 2000.0),  # as vmc3
        acceleration=1.5,
        rapid_mm_per_min=12000.0,
        thermometers=THERMOMETERS,
        capability=Capability(
            6000.0,
            dict.fromkeys("XYZ", 6000.0),
            {"X": (0.0, 800.0), "Y": (0.0, 500.0), "Z": (0.0, 500.0)},
        ),
        iron=0.9,
    )
)
