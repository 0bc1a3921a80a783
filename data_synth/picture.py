"""One picture of a data set: temperatures and drift of the tool tip over its first run."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from data_synth.network import Array
from data_synth.run import Run


def draw(path: Path, machine: str, run: Run, tip_um: Array) -> None:
    """Draw a run: its sensors, its spindle speed, the tip's drift (u, 3) in the middle of the volume."""
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    above, middle, below = figure.subplots(3, 1, sharex=True, height_ratios=(4, 1.5, 3))
    hours = run.time_s / 3600.0
    for k, (name, values) in enumerate(run.sensors.items()):
        above.plot(hours, values, label=name, linewidth=1.0, color=f"C{k % 10}", linestyle="-" if k < 10 else "--")
    above.set_ylabel("temperature [°C]")
    above.set_title(f"{machine}, run {run.name}")
    figure.legend(*above.get_legend_handles_labels(), loc="outside upper center", ncols=6, fontsize="small")
    middle.fill_between(hours, run.channels["spindle_rpm"], step="pre", color="0.6", linewidth=0.0)
    middle.set_ylabel("spindle [rpm]")
    for k, axis in enumerate("XYZ"):
        below.plot(run.terms_time_s / 3600.0, tip_um[:, k], label=axis.lower(), color=f"C{k}")
    below.axhline(0.0, color="0.8", linewidth=0.8)
    below.set_ylabel("tip drift since the start [µm]")
    below.set_xlabel("time since power-on [h]")
    below.legend(loc="best")
    for axes in (above, middle, below):
        axes.grid(color="0.92")
    figure.savefig(path, dpi=110, metadata={"Software": None})  # the same data give the same bytes
