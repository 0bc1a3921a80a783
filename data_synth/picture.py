"""The first picture of a data set: temperatures and drift of the tool tip over one run."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from data_synth.network import Array
from data_synth.run import Run

WIDTH = 9.0  # of every picture [in]
LONGEST_H = 72.0
"""Of longer runs only the beginning is drawn (chosen): more is a blur."""


def save(figure: Figure, path: Path) -> None:
    """Write a figure; the same data give the same bytes."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # which would lay it out twice more
    figure.savefig(path, dpi=110, metadata={"Software": None})


def draw(path: Path, machine: str, run: Run, tip_um: Array) -> None:
    """Draw a run: its sensors, its spindle speed, the tip's drift (u, 3) in the middle of the volume."""
    figure = Figure(figsize=(WIDTH, 7.4), layout="constrained")
    above, middle, below = figure.subplots(3, 1, sharex=True, height_ratios=(4, 1.2, 3))
    hours = run.time_s / 3600.0
    for k, (name, values) in enumerate(run.sensors.items()):
        above.plot(hours, values, label=name, linewidth=1.0, color=f"C{k % 10}", linestyle="-" if k < 10 else "--")
    above.set_ylabel("temperature [°C]")
    above.set_title(f"{machine}, run {run.name}")
    figure.legend(*above.get_legend_handles_labels(), loc="outside upper center", ncols=6, fontsize="small")
    middle.fill_between(hours, run.channels["spindle_rpm"], step="pre", color="0.6", linewidth=0.0)
    middle.set_ylabel("spindle [rpm]")
    for k, axis in enumerate("xyz"):
        below.plot(run.terms_time_s / 3600.0, tip_um[:, k], label=axis, color=f"C{k}")
    below.axhline(0.0, color="0.8", linewidth=0.8)
    below.set_ylabel("tip drift since the start [µm]")
    below.set_xlabel("time since power-on [h]")
    below.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, fontsize="small")
    below.set_xlim(0.0, min(hours[-1], LONGEST_H))
    for axes in (above, middle, below):
        axes.grid(color="0.92")
        axes.set_axisbelow(True)
    figure.align_ylabels()
    save(figure, path)
