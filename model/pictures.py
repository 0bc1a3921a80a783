"""Pictures of a machine: its chain, and its error budget. Needs matplotlib, from the train extra."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from model.describe import direction_text
from model.exceptions import DataError
from model.structure import Body
from model.term_classes import TermClass

if TYPE_CHECKING:
    from model.budget import Budget
    from model.machine import Machine

SIDE_COLOURS = {-1: "#fbe3c8", 0: "#e4e4e4", 1: "#cfe3f1"}
CLASS_COLOURS: dict[TermClass, str] = {"principal": "#0b6e4f", "secondary": "#d9a441"}
BARS = 48
"""Terms drawn in a budget; the rest are counted in a line."""


def draw_chain(path: str | Path, machine: Machine) -> None:
    """Draw the bodies as boxes, the bed at the bottom, each above its lower body.

    Raises
    ------
    DataError
        where the file cannot be written or its ending is not a picture's.
    """
    rows = [*machine.bodies]
    for name, at in (("workpiece", machine.layout.workpiece), *machine.layout.tools.items()):
        if machine.bodies[at].name != name:  # a leaf without errors is no body; it is drawn all the same
            rows.append(Body(name, at, None, -1 if name == "workpiece" else 1))
    places = _places(rows)
    width, height = max(x for x, _ in places), max(y for _, y in places)
    figure = _figure((max(2.4 * width + 2.4, 5.0), 1.1 * height + 1.6))
    axes = figure.subplots()
    for index, body in enumerate(rows):
        x, y = places[index]
        if body.lower >= 0:
            below = places[body.lower]
            axes.plot([x, below[0]], [y, below[1]], color="0.3", lw=1.5, zorder=1)
        counted = index < len(machine.bodies)
        box = {"boxstyle": "round,pad=0.5", "facecolor": SIDE_COLOURS[body.side], "edgecolor": "0.3"}
        label = (f"{index + 1}  " if counted else "") + body.name + _motion(machine, body)
        axes.text(x, y, label, ha="center", va="center", bbox={**box, "linestyle": "-" if counted else "--"})
    axes.set_xlim(-0.6, width + 0.6)
    axes.set_ylim(-0.5, height + 0.5)
    axes.set_axis_off()
    axes.set_title(f"{machine.name}: orange carries the workpiece, blue the tool", fontsize=10)
    _save(figure, path)


def draw_budget(path: str | Path, found: Budget, title: str) -> None:
    """Draw the largest contributions as bars, with their shares.

    Raises
    ------
    DataError
        where the file cannot be written or its ending is not a picture's.
    """
    shown = found.contributions[:BARS]
    figure = _figure((8.0, 1.4 + 0.26 * len(shown)))
    axes = figure.subplots()
    values = [c.tip_um for c in shown]
    axes.barh(range(len(shown)), values, color=[CLASS_COLOURS[c.term_class] for c in shown])
    for row, c in enumerate(shown):
        axes.text(
            c.tip_um, row, f" {100 * c.share:.1f} %" if abs(c.share) >= 0.0005 else " < 0.1 %", va="center", fontsize=8
        )
    axes.set_yticks(range(len(shown)), [c.term.name for c in shown])
    axes.set_ylim(len(shown) - 0.4, -0.6)
    axes.set_xlim(0.0, 1.12 * max(values) or 1.0)
    axes.set_xlabel("tip displacement of the term alone, rms over the working volume [µm]; share of the mean square")
    for name, colour in CLASS_COLOURS.items():
        axes.barh([0], [0], color=colour, label=f"{name}: {found.count(name)} terms")
    axes.legend(loc="lower right", frameon=False)
    axes.grid(axis="x", color="0.92")
    axes.set_axisbelow(True)
    left = len(found.contributions) - len(shown)
    axes.set_title(title + (f" (the largest {len(shown)}, {left} more below)" if left else ""), fontsize=10)
    _save(figure, path)


def _places(rows: list[Body]) -> list[tuple[float, float]]:
    """Return x and y of each body: leaves side by side, every other one amid what it carries."""
    x, y = [0.0] * len(rows), [0.0] * len(rows)
    above = [[i for i, b in enumerate(rows) if b.lower == at] for at in range(len(rows))]
    leaves = 0

    def place(at: int, depth: float) -> None:
        nonlocal leaves
        y[at] = depth
        for i in above[at]:
            place(i, depth + 1.0)
        if above[at]:
            x[at] = sum(x[i] for i in above[at]) / len(above[at])
        else:
            x[at] = float(leaves)
            leaves += 1

    place(0, 0.0)
    return list(zip(x, y, strict=True))


def _motion(machine: Machine, body: Body) -> str:
    if body.axis is None:
        return ""
    axis = machine.axes[body.axis]
    verb = "turns about" if axis.rotary else "moves along"
    return f"\n{verb} {direction_text(axis.direction)}\n{axis.low:g} ... {axis.high:g} {axis.unit}"


def _figure(size: tuple[float, float]) -> Any:
    from matplotlib.figure import Figure  # noqa: PLC0415 (not in the base install)

    return Figure(figsize=size, layout="constrained")


def _save(figure: Any, path: str | Path) -> None:
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else str(problem).splitlines()[0]
        raise DataError(f"picture '{path}' cannot be written: {reason}") from None
