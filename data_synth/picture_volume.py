"""The tool tip's drift over the working volume at one moment: slices, length as colour, direction as arrows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from data_synth.fields import Terms
from data_synth.network import Array
from data_synth.picture import WIDTH, save
from data_synth.probe import errors_at
from model.chain import Chain
from model.machine import Machine

SLICES, ACROSS = 3, 9
"""Heights, and positions along each side of a slice."""


def draw_volume(path: Path, machine: Machine, title: str, terms: Terms) -> None:
    """Draw the drift that one sample of error terms makes, in the frame of the workpiece.

    Slices lie at the lowest, middle and highest position of the third linear axis. Rotary axes stand in the middle of
    their range, as near 0 as it allows.
    """
    right, up, height = _directions(machine)
    q = _grid(machine, right, up, height)
    e = errors_at(machine, terms, np.zeros(len(q), dtype=np.intp), q)
    drift = 1e3 * np.einsum("nik,nk->ni", Chain(machine).sensitivity(q)[:, :3], e)
    drift = drift.reshape(SLICES, ACROSS, ACROSS, 3)  # height, up, right
    length = np.linalg.norm(drift, axis=-1)
    axes = [q[:, machine.axis_names.index(a)].reshape(SLICES, ACROSS, ACROSS) for a in (right, up, height)]
    wide, deep = float(np.ptp(axes[0])), float(np.ptp(axes[1]))
    step = max(wide, deep) / (ACROSS - 1)
    panel_in = 0.28 * WIDTH * (deep + 2.0 * step) / (wide + 2.0 * step)
    figure = Figure(figsize=(WIDTH, min(max(panel_in, 1.2), 5.0) + 1.9), layout="constrained")
    figure.suptitle(title)
    panels = figure.subplots(1, SLICES, sharex=True, sharey=True)
    norm = Normalize(float(length.min()), float(length.max()))
    seen = drift[..., ["XYZ".index(right), "XYZ".index(up)]]
    longest = float(np.linalg.norm(seen, axis=-1).max())
    for k, panel in enumerate(panels):
        x, y = axes[0][k], axes[1][k]
        mesh = panel.pcolormesh(x, y, length[k], norm=norm, cmap="YlOrRd", shading="gouraud")
        panel.quiver(
            x, y, seen[k, ..., 0], seen[k, ..., 1],
            angles="xy", scale_units="xy", scale=max(longest, 1e-9) / (0.9 * step), color="0.15", width=0.006,
        )  # fmt: skip
        panel.set_title(f"{height} = {axes[2][k, 0, 0]:g} mm", fontsize="medium")
        panel.set_xlabel(f"{right} [mm]")
        panel.set_aspect("equal")
        panel.use_sticky_edges = False  # room for the arrows at the edges
        panel.margins(step / wide, step / deep)
        panel.set_xticks([x[0, 0], x[0, ACROSS // 2], x[0, -1]])
        panel.set_yticks([y[0, 0], y[ACROSS // 2, 0], y[-1, 0]])
    panels[0].set_ylabel(f"{up} [mm]")
    bar = figure.colorbar(mesh, ax=panels, location="bottom", aspect=50, pad=0.02)
    bar.set_label(f"length of the tip's drift [µm]; arrows: its part along {right} and {up}, longest {longest:.3g} µm")
    save(figure, path)


def _directions(machine: Machine) -> tuple[str, str, str]:
    linear = [a for a in "XYZ" if a in machine.axis_names]
    return linear[0], linear[1], linear[2]


def _grid(machine: Machine, right: str, up: str, height: str) -> Array:
    middle = []
    for name in machine.axis_names:
        axis = machine.axes[name]
        middle.append(float(np.clip(0.0, axis.low, axis.high)) if axis.rotary else (axis.low + axis.high) / 2.0)
    q = np.tile(middle, (SLICES, ACROSS, ACROSS, 1))
    ends = {name: (machine.axes[name].low, machine.axes[name].high) for name in (right, up, height)}
    q[..., machine.axis_names.index(right)] = np.linspace(*ends[right], ACROSS)
    q[..., machine.axis_names.index(up)] = np.linspace(*ends[up], ACROSS)[:, None]
    q[..., machine.axis_names.index(height)] = np.linspace(*ends[height], SLICES)[:, None, None]
    return q.reshape(-1, len(middle))
