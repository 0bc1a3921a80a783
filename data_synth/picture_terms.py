"""Error terms as Su, Li and Wang (2001) show them, in figures of our own: figures 3, 4 and 5 for any machine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from data_synth.fields import Terms
from data_synth.network import Array
from data_synth.picture import WIDTH, save
from model.machine import Machine
from model.term_classes import squareness_terms
from model.terms import DIRECTIONS, Term

TIMES = 6  # at which motion errors are drawn, from start to end
COLOURS = colormaps["viridis"]
FLAT, LEAST = 0.02, 1e-3
"""Smallest height of a panel (chosen), so that rounding is no curve: share of the highest with its unit; µm, µrad."""


def motion_axes(machine: Machine) -> list[str]:
    """Return the axes whose motion errors are drawn: Z, as in the seed's figure 3, and the rotary ones."""
    linear = [name for name, axis in machine.axes.items() if not axis.rotary]
    rotary = [name for name, axis in machine.axes.items() if axis.rotary]
    return (["Z"] if "Z" in linear else linear[-1:]) + rotary


def draw_motion(path: Path, machine: Machine, run: str, time_s: Array, terms: Terms, axis: str) -> None:
    """Draw the six motion errors of an axis over its position at several times: the seed's figure 3."""
    figure, panels = _six(f"{machine.name}, run {run}: motion errors of {axis} over its position")
    at = np.linspace(0, len(time_s) - 1, TIMES).round().astype(np.intp)
    shades = COLOURS(np.linspace(0.0, 0.92, TIMES))  # the last yellow is too light on white
    values = terms.motion[axis][at]  # (times, 6, n)
    for k, panel in enumerate(panels):
        for shade, curve in zip(shades, values[:, k], strict=True):
            panel.plot(terms.positions[axis], curve, color=shade, marker="o", markersize=2.5, linewidth=1.2)
        panel.set_title(_words(machine, f"E{DIRECTIONS[k]}{axis}"), fontsize="medium")
    unit = "degree" if machine.axes[axis].rotary else "mm"
    for panel in panels[3:]:
        panel.set_xlabel(f"{axis} [{unit}]")
    _even(panels[:3], values[:, :3])
    _even(panels[3:], values[:, 3:])
    scale = ScalarMappable(BoundaryNorm(np.arange(TIMES + 1), TIMES), ListedColormap(shades))
    bar = figure.colorbar(scale, ax=panels, ticks=np.arange(TIMES) + 0.5, aspect=40, pad=0.02)
    bar.ax.set_yticklabels([f"{time_s[k] / 3600.0:.1f}" for k in at])
    bar.ax.tick_params(length=0.0)
    bar.set_label("time since power-on [h]")
    save(figure, path)


def draw_location(path: Path, machine: Machine, run: str, time_s: Array, terms: Terms) -> str:
    """Draw the six location errors of the first moving body over time; return its axis.

    The seed's figure 4: its bodies 1 and 2 are the bed and what moves on it.
    """
    axis = next(body.axis for body in machine.bodies if body.axis is not None)
    figure, panels = _six(f"{machine.name}, run {run}: location errors of {axis}, the first axis on the bed")
    values = terms.location[axis]
    for k, panel in enumerate(panels):
        panel.plot(time_s / 3600.0, values[:, k], color="C0" if k < 3 else "C3", linewidth=1.2)
        panel.set_title(f"E{DIRECTIONS[k]}0{axis} [{'µm' if k < 3 else 'µrad'}]", fontsize="medium")
    for panel in panels[3:]:
        panel.set_xlabel("time since power-on [h]")
    _even(panels[:3], values[:, :3])
    _even(panels[3:], values[:, 3:])
    save(figure, path)
    return axis


def draw_angles(path: Path, machine: Machine, run: str, time_s: Array, terms: Terms) -> list[str]:
    """Draw the angles between axes over time, and the tool holder's shift beside them; return the angles' names.

    The seed's figure 5: its γ of X, α and β of Z are the squareness errors of a three-axis machine.
    """
    square = squareness_terms(machine)
    angles = [t for t in machine.terms if t.name in square or (_rotary(machine, t) and t.angular)]
    shifts = [t for t in machine.terms if t.kind == "location" and t.axis == "T" and not t.angular]
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    figure.suptitle(f"{machine.name}, run {run}: angles between axes" + (" and the tool holder" if shifts else ""))
    shown = [(angles, "angle [µrad]"), (shifts, "shift of the tool holder [µm]")]
    shown = [(found, label) for found, label in shown if found]
    for panel, (found, label) in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
        for k, term in enumerate(found):
            name = f"{term.name}, {square[term.name]}" if term.name in square else term.name
            values = terms.location[term.axis][:, DIRECTIONS.index(term.direction)]
            panel.plot(time_s / 3600.0, values, label=name, color=f"C{k}", linewidth=1.2)
        panel.set_ylabel(label)
        panel.set_xlabel("time since power-on [h]")
        panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), fontsize="small", ncols=2, frameon=False)
        _frame(panel)
    save(figure, path)
    return [term.name for term in angles]


def _six(title: str) -> tuple[Figure, list[Axes]]:
    """Return a figure with three panels for shifts above three for turns."""
    figure = Figure(figsize=(WIDTH, 5.4), layout="constrained")
    figure.suptitle(title)
    panels = list(figure.subplots(2, 3, sharex=True).flat)
    for panel in panels:
        _frame(panel)
    return figure, panels


def _frame(panel: Axes) -> None:
    panel.grid(color="0.92")
    panel.set_axisbelow(True)


def _even(panels: list[Axes], values: Array) -> None:
    """Give each panel its own scale, but none so fine that nothing looks like something."""
    high, low = values.max(axis=(0, *range(2, values.ndim))), values.min(axis=(0, *range(2, values.ndim)))
    least = max(FLAT * float((high - low).max()), LEAST)
    for panel, top, bottom in zip(panels, high, low, strict=True):
        middle, half = (top + bottom) / 2.0, max(top - bottom, least) * 0.55
        panel.set_ylim(middle - half, middle + half)


def _words(machine: Machine, name: str) -> str:
    term = machine.term(name)
    return f"{name} [{'µrad' if term.angular else 'µm'}]"


def _rotary(machine: Machine, term: Term) -> bool:
    """Return whether the term is a location error of a rotary axis."""
    return term.kind == "location" and term.axis in machine.axes and machine.axes[term.axis].rotary
