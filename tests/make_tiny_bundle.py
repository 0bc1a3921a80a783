"""Make `tests/data/tiny_bundle`, a small real bundle for tests that run without torch.

Run it with the train extra installed: `python tests/make_tiny_bundle.py`. Its network is chosen, not trained,
so what it must answer can be worked out by hand: all sensors 1 K above 20 °C for long give the thermal terms
EZ0T = -4 µm, EXX = 0 ... +8 µm over the axis and EC0Y = 2 µrad.
"""

from pathlib import Path

import torch

from model.bundle import write_bundle
from model.fields import Fields
from model.machine import parse_machine
from model.manifest import NetworkRecord
from model.network import EXPORTER, OPSET, InputScale, Prior, ThermalNetwork, export_onnx
from training.export import parity_sample

FOLDER = Path(__file__).parent / "data" / "tiny_bundle"

MACHINE = """\
name = "tiny"
structure = "w X Y b Z t"
reference_temperature_degC = 20.0

[axes.X]
range = [0.0, 800.0]
[axes.Y]
range = [0.0, 500.0]
[axes.Z]
range = [0.0, 500.0]

[tool]
offset_mm = [0.0, 0.0, -100.0]
errors = true

[sensors.spindle]
range_degC = [-10.0, 100.0]
[sensors.column]
range_degC = [-10.0, 60.0]
[sensors.ambient]
range_degC = [-10.0, 50.0]

[limits]
max_correction_um = 300.0
max_rate_um_per_min = 60.0
"""

TERMS = ["EXX", "EC0Y", "EZ0T"]
TIME_CONSTANTS_S = [300.0, 3600.0]


def main() -> None:
    """Write the bundle."""
    machine = parse_machine(MACHINE)
    scale = InputScale(centre_degC=[20.0] * 3, swing_K=1.0, largest=[10000.0], switched=[False])
    prior = Prior(tuple(TIME_CONSTANTS_S), powers=(1.0,), source=1.0, instant=1.0, tau_exponent=0.0, common=0.0)
    net = ThermalNetwork(scale, prior, coefficients=2 + 1 + 1)  # EXX of degree 1, EC0Y, EZ0T
    with torch.no_grad():
        weights = net.linear.view(4, 3, 4)  # inputs, (immediate, fast mode, slow mode), coefficients
        # The mean temperature counts, and full speed as much as 2 K.
        for source, share in enumerate((1 / 3, 1 / 3, 1 / 3, 2.0)):
            weights[source, 2, 0] = 4.0 * share  # EXX: mean over the axis
            weights[source, 2, 1] = 4.0 * share  # EXX: slope, so that it is zero at X = 0
            weights[source, 2, 2] = 2.0 * share  # EC0Y
            weights[source, 1, 3] = -4.0 * share  # EZ0T: the spindle grows towards the workpiece
    ranges = {"spindle": (15.0, 45.0), "column": (15.0, 35.0), "ambient": (15.0, 30.0)}
    channel_ranges = {"spindle_rpm": (0.0, 10000.0)}
    record = NetworkRecord(
        sensors=list(ranges),
        channels=list(channel_ranges),
        terms=TERMS,
        degree=1,
        modes=net.modes,
        time_constants_s=TIME_CONSTANTS_S,
        datum="absolute",
        settling_time_s=3600.0,
        valid_range_degC=ranges,
        valid_range_channels=channel_ranges,
        sensor_mean_degC=[25.0, 22.0, 20.0],
        sensor_covariance_K2=[[25.0, 9.0, 2.0], [9.0, 4.0, 1.0], [2.0, 1.0, 1.0]],
        opset=OPSET,
        exporter=EXPORTER,
        parity=parity_sample(net, Fields(machine, tuple(TERMS), degree=1), ranges, channel_ranges),
    )
    geometry = [
        ("EXX", 0.0, 0.0),
        ("EXX", 800.0, 12.0),
        ("EYX", 0.0, 0.0),
        ("EYX", 400.0, 3.0),
        ("EC0Y", None, -20.0),
    ]
    bundle = write_bundle(FOLDER, machine, geometry=geometry, network=export_onnx(net), record=record)
    print(f"{bundle.path}: {len(bundle.network or b'')} bytes of network")


if __name__ == "__main__":
    main()
