"""The picture of what sensors are worth: how much is left by how many of them, and without each."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

from training.sensor_selection import Selection

GREEN, RED, GREY = "#0b6e4f", "#d1495b", "#8d99ae"
"""As in `picture.py`."""


def draw_selection(path: str | Path, selection: Selection, title: str) -> None:
    """Draw the curve over the number of sensors, and the worth of each sensor and channel."""
    matplotlib.use("Agg")
    from matplotlib import pyplot  # noqa: PLC0415 (after the backend is chosen)

    rows = len(selection.sensors) + len(selection.channels)
    figure, (curve, bars) = pyplot.subplots(1, 2, figsize=(12.5, max(5.0, 0.3 * rows + 1.5)), constrained_layout=True)
    sizes = np.arange(len(selection.sizes))
    steps = (("taking away", selection.backward, sizes[-2::-1], "--"), ("adding", selection.forward, sizes[1:], ":"))
    for name, path_of, at, style in steps:
        curve.plot(at, [s.left_um for s in path_of], style, color=GREY, lw=1.2, label=f"{name} one at a time")
    told = [s.left_um for s in selection.told]
    curve.plot(sizes[-2::-1], told, "-.", color=GREY, lw=1.2, label="taking away what the others tell best")
    fair = [size.left_um if size.fair_um is None else size.fair_um for size in selection.sizes]
    curve.plot(sizes, fair, "o-", color=GREEN, lw=1.8, ms=4, label="chosen without what it is judged on")
    limit = (1.0 + selection.loss) * selection.all_um
    curve.axhline(limit, color=RED, lw=1.0, label=f"{selection.loss:.0%} more than all sensors")
    best = len(selection.best.sensors)
    curve.plot([best], [fair[best]], "o", ms=12, mfc="none", mec=RED, mew=1.8)
    curve.annotate(f"{best} sensors", (best, fair[best]), xytext=(6, 14), textcoords="offset points", color=RED)
    curve.set_ylim(0.0, 1.05 * max(fair[0], limit))
    curve.set_xlabel("sensors beside all channels" if selection.channels else "sensors")
    curve.set_ylabel("left at the tip, RMS [µm]")
    curve.legend(frameon=False)
    curve.grid(alpha=0.3)
    curve.set_title(f"{title}: {selection.drift_um:.1f} µm without compensation", loc="left")
    inputs = [*selection.sensors, *selection.channels]
    kept = set(selection.best.sensors)
    at = np.arange(rows)
    colours = [GREEN if w.name in kept else RED if w in selection.channels else GREY for w in inputs]
    growth = [100.0 * selection.more(w.without_um) for w in inputs]
    bars.barh(at, growth, color=colours)
    bars.axvline(0.0, color="black", lw=0.8)
    bars.set_yticks(at, [w.name for w in inputs])
    bars.set_ylim(rows - 0.4, -0.6)
    bars.set_xlabel("more left at the tip when it alone is taken away [%]")
    bars.set_title("green: in the small set, red: channels", loc="left")
    bars.grid(axis="x", alpha=0.3)
    bars.set_axisbelow(True)
    figure.savefig(path, dpi=100)
    pyplot.close(figure)
