"""Thermal design of `vmc3`: a C-frame machining centre of five tonnes, 12 000 rpm, screws of 40 mm."""

from __future__ import annotations

from data_synth.c_frame import Figures, design
from data_synth.capability import Capability
from data_synth.heat import BearingFriction, PowerLaw
from data_synth.sensors import Thermometer
from data_synth.vmc3_structure import SCREWS, STRUCTURE

THERMOMETERS = {
    "spindle_front": Thermometer({"spindle_front": 0.8, "chiller": 0.2}, lag_s=40.0),
    "spindle_rear": Thermometer({"spindle_rear": 0.7, "head_front_right": 0.3}, lag_s=120.0),
    "motor": Thermometer({"motor": 1.0}, lag_s=60.0),
    "head": Thermometer({"head_front_low": 0.7, "head_rear_left": 0.3}, lag_s=60.0),
    "column_front": Thermometer({"column_upper_left": 0.8, "column_lower_left": 0.2}, lag_s=60.0),
    "column_rear": Thermometer({"column_lower_rear": 0.6, "column_upper_rear": 0.4}, lag_s=60.0),
    "bed": Thermometer({"bed_front_left": 1.0}, lag_s=60.0),
    "nut_x": Thermometer({"nut_x": 0.8, "table_right": 0.2}, lag_s=60.0),
    "nut_y": Thermometer({"nut_y": 0.8, "saddle_left_base": 0.2}, lag_s=60.0),
    "nut_z": Thermometer({"nut_z": 0.8, "head_rear_right": 0.2}, lag_s=60.0),
    "coolant": Thermometer({"coolant": 1.0}, lag_s=60.0),
    "ambient": Thermometer({"air_right": 1.0}, lag_s=180.0),
}

VMC3 = design(
    Figures(
        name="vmc3",
        structure=STRUCTURE,
        screws=SCREWS,
        # Angular contact balls of 70 and 60 mm bore, oil and air: f0 = 1 (Harris and Kotzalas,
        # table of f0), ν = 12 mm²/s when warm.
        front=BearingFriction(2, 90.0, 1.0, 12.0, 40.0),
        rear=BearingFriction(2, 78.0, 1.0, 12.0, 30.0),
        motor=PowerLaw(500.0, 12000.0, 1.2),  # iron and copper losses of 15 kW
        to_chiller=(18.0, 12.0, 3.0),
        guides=PowerLaw(40.0, 10000.0, 1.0),
        moved_kg=(1900.0, 2400.0, 2000.0),  # screw and rotor, 0.01 kg m², stand for 1500 kg of it
        acceleration=5.0,
        rapid_mm_per_min=30000.0,
        thermometers=THERMOMETERS,
        capability=Capability(
            12000.0,
            dict.fromkeys("XYZ", 15000.0),
            {"X": (0.0, 800.0), "Y": (0.0, 500.0), "Z": (0.0, 500.0)},
        ),
    )
)
