"""The report's figures, each with a text alternative. Colours differ in lightness too, for black-and-white print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from model.fields import Fields
from model.terms import Term
from model.transforms import Array
from training.coverage import columns_by_term
from training.dataset import DataSet
from training.evaluation import NETWORK, NO_COMPENSATION
from training.report.left_out import LeftOutRun
from training.report.modes import ModeWeights
from training.report.svg import draw
from training.report.units import duration, micrometres, percent
from training.split import Mask

WIDTH = 7.0
"""Of every figure [inch]: what A4 leaves between its margins."""
TRUTH, GREEN, RED = "#222222", "#0b6e4f", "#d1495b"
TRAINED, BAND = "#efe9dc", "#cfe8dd"
INTERVAL = "95 % interval"
FEW = 60
"""Fewer measurements of a run are marked one by one."""
MOST_DOTS = 300
"""Positions of the tip that are drawn: more would be a grey block and a large file."""
MOST_PAIRS = 4
"""Pairs of axes that fit side by side."""
SMALLEST = 1.0
"""A term is drawn on a scale of at least ± this [µm, µrad]: less is nothing, and should not look like something."""


def follow_run(prefix: str, run: LeftOutRun, baseline: str | None, legend: bool) -> str:
    """Draw a left-out run: residuals in x, y, z at the middle of the volume and over the volume, before and after."""
    shown = [m for m in (NO_COMPENSATION, baseline, NETWORK) if m is not None]
    styles: dict[str, dict[str, Any]] = {
        NO_COMPENSATION: {"color": TRUTH, "lw": 1.4},
        NETWORK: {"color": GREEN, "lw": 1.4},
    }

    def fill(figure: Any) -> None:
        from matplotlib.ticker import MaxNLocator  # noqa: PLC0415 (slow to import)

        panels = figure.subplots(1, 4, sharex=True)
        tip = [run.at_um[m] for m in shown]
        allowed = run.allowed_um
        usual = [] if allowed is None else [np.median(allowed, axis=0), -np.median(allowed, axis=0)]
        low, high = _limits(np.concatenate([*(t.ravel() for t in tip), *usual]))
        for d, axes in enumerate(panels):
            for method in shown:
                values = run.at_um[method][:, d] if d < 3 else run.rms_um[method]
                style = styles.get(method, {"color": RED, "lw": 1.0, "ls": (0, (3, 1.5))})
                known = np.isfinite(values)  # what was measured now and then is joined by lines
                marks = {"marker": "o", "ms": 1.8} if known.sum() < FEW or not run.alike else {}
                joined = {} if run.alike else {"ls": "none"}
                axes.plot(run.hours[known], values[known], label=method, **{**style, **marks, **joined})
            if allowed is not None and d < 3:
                edge = allowed[:, d]
                axes.fill_between(run.hours, -edge, edge, color=BAND, lw=0, zorder=0.5, label=INTERVAL)
            if not run.left_out.all():
                for begin, end in _stretches(~run.left_out, run.hours):
                    axes.axvspan(begin, end, color=TRAINED, lw=0, zorder=0)
            axes.set_title(f"tip in {'xyz'[d]} [µm]" if d < 3 else "over the volume [µm]", loc="left")
            axes.set_xlabel("time since power-on [h]", fontsize=7)
            axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
            if d < 3:
                axes.set_ylim(low, high)  # one scale, so that the directions can be compared
                axes.tick_params(labelleft=d == 0)
            else:
                axes.set_ylim(bottom=0.0)
        if legend:
            figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)

    before, after = run.worst_um(NO_COMPENSATION), run.worst_um(NETWORK)
    alt = (
        f"Line charts of run {run.name} over {run.hours[-1] - run.hours[0]:.1f} hours. Without compensation the tip's "
        f"deviation over the volume reaches {micrometres(before)}, with the network {micrometres(after)}."
    )
    return draw(prefix, alt, (WIDTH, 1.75 if legend else 1.5), fill)


def _limits(values: Array) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    margin = 0.05 * (high - low) or 1.0
    return low - margin, high + margin


def _stretches(mask: Mask, at: Array) -> list[tuple[float, float]]:
    """Return where a mask is true without a break, as pairs of coordinates."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(float(at[b]), float(at[min(e, len(at) - 1)])) for b, e in zip(edges[::2], edges[1::2], strict=True)]


def motion_terms(
    prefix: str, dataset: DataSet, axis: str, run: LeftOutRun, row: int, fields: Fields, coefficients: Array
) -> str | None:
    """Draw the motion terms of an axis at one time, measured and predicted, over position; None where none was."""
    machine = dataset.machine
    columns = columns_by_term(dataset.columns)
    names = [n for n in dataset.measured_terms if machine.term(n).kind == "motion" and machine.term(n).axis == axis]
    values = run.measured.values[row]
    names = [n for n in names if np.isfinite(values[columns[n]]).any()]
    if not names:
        return None
    at = np.linspace(machine.axes[axis].low, machine.axes[axis].high, 61)
    gaps: list[str] = []

    def fill(figure: Any) -> None:
        rows = (len(names) + 2) // 3
        panels = np.ravel(figure.subplots(rows, 3, sharex=True, squeeze=False))
        for panel in panels[len(names) :]:
            panel.set_axis_off()
        for name, panel in zip(names, panels, strict=False):
            term = machine.term(name)
            places = np.array([dataset.columns[j][1] or 0.0 for j in columns[name]])
            predicted = fields.basis(name, at) @ coefficients[fields.slices()[name]]
            panel.axhline(0.0, color="0.6", lw=0.6)
            panel.plot(places, values[columns[name]], "o", ms=2.6, color=TRUTH, label="measured")
            panel.plot(at, predicted, color=GREEN, lw=1.4, label=NETWORK)
            low, high = _limits(np.concatenate([values[columns[name]], predicted]))
            panel.set_ylim(min(low, -SMALLEST), max(high, SMALLEST))
            panel.set_title(f"{name} [{symbol(term)}]", loc="left")
        for panel in panels[max(len(names) - 3, 0) : len(names)]:
            panel.set_xlabel(f"{axis} [{machine.axes[axis].unit}]")
            panel.tick_params(labelbottom=True)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)

    for name in names:
        there = np.array([dataset.columns[j][1] or 0.0 for j in columns[name]])
        gap = values[columns[name]] - fields.basis(name, there) @ coefficients[fields.slices()[name]]
        gaps.append(f"{name} by up to {np.nanmax(np.abs(gap)):.1f} {symbol(machine.term(name))}")
    alt = f"Charts of the motion terms of axis {axis} over its position; the network misses {', '.join(gaps)}."
    return draw(prefix, alt, (WIDTH, 0.35 + 1.25 * ((len(names) + 2) // 3)), fill)


def symbol(term: Term) -> str:
    """Return the unit of a term for people."""
    return "µrad" if term.angular else "µm"


def mode_bars(prefix: str, weights: ModeWeights) -> str:
    """Draw how much each time constant moves the tip."""
    labels = ["at once", *(duration(tau) for tau in weights.time_constants_s)]
    with_sources = bool(weights.sources_um.any())

    def fill(figure: Any) -> None:
        axes = figure.subplots()
        at = np.arange(len(labels))
        width = 0.38 if with_sources else 0.6
        offset = width / 2 if with_sources else 0.0
        axes.bar(at - offset, weights.temperatures_um, width, color=GREEN, label="temperatures")
        if with_sources:
            axes.bar(at + offset, weights.sources_um, width, color="#d9a441", label="heat sources (channels)")
        axes.set_xticks(at, labels)
        axes.set_xlabel("time constant")
        axes.set_ylabel("moves the tip by, rms [µm]")
        axes.grid(visible=False, axis="x")
        axes.legend()

    parts = [
        f"{label} {micrometres(t)} from temperatures" + (f" and {micrometres(s)} from channels" if with_sources else "")
        for label, t, s in zip(labels, weights.temperatures_um, weights.sources_um, strict=True)
    ]
    return draw(
        prefix, f"Bar chart of how far each time constant moves the tip: {'; '.join(parts)}.", (WIDTH, 2.2), fill
    )


def loss_curves(prefix: str, folds: Sequence[Sequence[float]], final: Sequence[float] | None) -> str:
    """Draw the loss of the nonlinear residual, step by step."""

    def fill(figure: Any) -> None:
        axes = figure.subplots()
        for i, curve in enumerate(folds):
            axes.plot(100.0 * np.asarray(curve), color="0.6", lw=0.9, label="folds" if i == 0 else None)
        if final is not None:
            axes.plot(100.0 * np.asarray(final), color=GREEN, lw=1.6, label="all training data")
        axes.set_xlabel("step of the optimiser")
        axes.set_ylabel("left of what the linear\ndecoder leaves [%]")
        axes.legend()

    ends = [curve[-1] for curve in [*folds, *([] if final is None else [final])]]
    alt = (
        f"Learning curves of the nonlinear residual: after {len(folds[0] if folds else final or [])} steps between "
        f"{percent(min(ends))} and {percent(max(ends))} of what the linear decoder leaves remain in training."
    )
    return draw(prefix, alt, (WIDTH, 2.1), fill)


def coverage_chart(prefix: str, dataset: DataSet, counts: Mapping[str, Array]) -> str | None:
    """Draw where along its axis each motion term was measured; larger dots, more often. None without motion terms.

    Parameters
    ----------
    counts : by term, how often each of its columns was measured
    """
    machine = dataset.machine
    columns = columns_by_term(dataset.columns)
    by_axis = {
        axis: [n for n in dataset.measured_terms if machine.term(n).kind == "motion" and machine.term(n).axis == axis]
        for axis in machine.axis_names
    }
    by_axis = {axis: names for axis, names in by_axis.items() if names}
    if not by_axis:
        return None
    most = max(int(count.max()) for count in counts.values())
    rows = max(len(names) for names in by_axis.values())

    def fill(figure: Any) -> None:
        for panel, (axis, names) in zip(
            figure.subplots(1, len(by_axis), squeeze=False)[0], by_axis.items(), strict=True
        ):
            for row, name in enumerate(names):
                places = [dataset.columns[j][1] or 0.0 for j in columns[name]]
                panel.scatter(places, [row] * len(places), s=2.0 + 22.0 * counts[name] / most, color=GREEN, lw=0)
            panel.set_yticks(range(len(names)), names)
            panel.set_ylim(rows - 0.5, -0.5)
            panel.set_xlim(*_limits(np.array([machine.axes[axis].low, machine.axes[axis].high])))
            panel.set_xlabel(f"{axis} [{machine.axes[axis].unit}]")

    said = [f"{a}: {', '.join(f'{n} at {len(columns[n])} positions' for n in names)}" for a, names in by_axis.items()]
    return draw(
        prefix, f"Dot chart of the measured positions, by axis. {'; '.join(said)}.", (WIDTH, 0.6 + 0.17 * rows), fill
    )


def tip_places(prefix: str, dataset: DataSet) -> str | None:
    """Draw where in the working volume the tip was measured, seen along each axis; None where it was not."""
    known = [run.places[np.isfinite(run.places).all(axis=2)] for run in dataset.runs.values() if run.places is not None]
    if not known:
        return None
    places, times = np.unique(np.concatenate(known), axis=0, return_counts=True)
    machine, names = dataset.machine, dataset.machine.axis_names
    shown = places[np.unique(np.linspace(0, len(places) - 1, MOST_DOTS).astype(int))]
    pairs = [(i, j) for i in range(len(names)) for j in range(i + 1, len(names))][:MOST_PAIRS]

    def fill(figure: Any) -> None:
        for panel, (i, j) in zip(np.ravel(figure.subplots(1, len(pairs), squeeze=False)), pairs, strict=True):
            panel.plot(shown[:, i], shown[:, j], "o", ms=2.0, mew=0, color=GREEN, alpha=0.7)
            for axis, label, limit in ((names[i], panel.set_xlabel, panel.set_xlim),
                                       (names[j], panel.set_ylabel, panel.set_ylim)):  # fmt: skip
                label(f"{axis} [{machine.axes[axis].unit}]")
                limit(*_limits(np.array([machine.axes[axis].low, machine.axes[axis].high])))

    alt = (
        f"Dot charts of the {len(places)} positions at which the tool tip was measured, {times.sum()} times in all, "
        "seen along each axis."
    )
    return draw(prefix, alt, (WIDTH, 2.0), fill) if pairs else None


def score_bars(prefix: str, shares: Mapping[str, float]) -> str:
    """Draw what each method leaves, as a share of no compensation."""

    def fill(figure: Any) -> None:
        axes = figure.subplots()
        names = list(shares)
        values = [100.0 * shares[n] for n in names]
        axes.barh(range(len(names)), values, color=[GREEN if n == NETWORK else "0.65" for n in names], height=0.65)
        for row, value in enumerate(values):
            axes.text(value + 0.01 * max(values), row, f"{value:.1f} %", va="center")
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(len(names) - 0.5, -0.5)
        axes.set_xlim(0.0, 1.12 * max(values))
        axes.set_xlabel("left of the tip's drift, rms over the working volume [%]")
        axes.grid(visible=False, axis="y")

    said = ", ".join(f"{name} {percent(share)}" for name, share in shares.items())
    return draw(
        prefix, f"Bar chart of the share of drift that is left: {said}.", (WIDTH, 0.55 + 0.24 * len(shares)), fill
    )
