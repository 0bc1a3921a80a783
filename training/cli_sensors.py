"""`thermotrue sensors`: what each sensor is worth, and which few do nearly as well as all."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from training.sensor_selection import Selection, Worth

PATH = click.Path(path_type=Path)


def _share(_ctx: click.Context, _option: click.Parameter, value: str) -> float:
    text = value.strip()
    try:
        share = float(text.removesuffix("%")) / (100.0 if text.endswith("%") else 1.0)
    except ValueError:
        share = math.nan
    if not (0.0 <= share <= 1.0):
        raise click.BadParameter(f"must be a share from 0 to 100% such as 10% or 0.1, got '{value}'")
    return share


@click.command()
@click.argument("dataset", type=PATH)
@click.option(
    "--loss",
    default="10%",
    show_default=True,
    callback=_share,
    help="How much more the small set may leave at the tip than all sensors.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.option("--plot", "--picture", "plot", type=PATH, help="Draw it into this file, such as sensors.png.")
def sensors(dataset: Path, loss: float, as_json: bool, plot: Path | None) -> None:
    """Say what each sensor of the data set folder DATASET is worth, and which few do nearly as well as all.

    Everything is judged by what the network's linear decoder leaves of the tool tip's deviation on measurements left
    out of its training: runs in turn, of a single run its spindle phases. Channels such as the spindle's speed cost no
    sensor: they stay, and their worth is shown for comparison.

    "without" is what is left when this sensor alone is taken away, "alone" when it alone is kept. Sensors that tell the
    same are each worth little, and much together: look at the groups.
    """
    import json

    from training.dataset import load_dataset
    from training.folds import folds
    from training.picture import check_picture
    from training.sensor_selection import select
    from training.sensor_sets import Inputs
    from training.tip import tip_metric
    from training.trainer import Settings

    if plot is not None:
        check_picture(plot)
    data = load_dataset(dataset)
    left_out = folds(data)
    found = select(Inputs(data, tip_metric(data), Settings()), left_out, loss)
    if plot is not None:
        from training.sensor_picture import draw_selection

        draw_selection(plot, found, data.machine.name)
    if as_json:
        parts = [split.description for split in left_out]
        click.echo(
            json.dumps({"machine": data.machine.name, "left_out": parts, **asdict(found)}, indent=1, allow_nan=False)
        )
        return
    _print(found, data.machine.name, len(left_out), single=len(data.runs) == 1)


def _print(found: Selection, machine: str, parts: int, *, single: bool) -> None:
    from rich.console import Console

    console = Console(width=None if Console().is_terminal else 110, highlight=False)
    kind = "parts of its one run" if single else "groups of runs"
    console.print(f"{machine}, judged on {parts} {kind}, each left out in turn; RMS at the tip [µm]:")
    for what, um in (
        ("without compensation", found.drift_um),
        ("all sensors and channels", found.all_um),
        *((("all sensors, no channel", found.sensors_um),) if found.channels else ()),
        ("all channels, no sensor" if found.channels else "no sensor", found.channels_um),
    ):
        console.print(f"  {what:<26}{um:8.2f}  {um / found.drift_um:6.1%}")
    console.print()
    console.print(_worths(found, found.sensors, "sensor", "alone beside the channels" if found.channels else "alone"))
    if found.channels:
        console.print(_worths(found, found.channels, "channel", "alone, no sensor"))
    console.print(_curve(found))
    best = found.best
    fair_um = best.left_um if best.fair_um is None else best.fair_um
    console.print(
        f"smallest set within {100.0 * found.loss:g}% of all: {len(best.sensors)} of {len(found.sensors)} sensors, "
        f"{fair_um:.2f} µm ({found.more(fair_um):+.1%})"
    )
    for name in best.sensors:
        others = found.instead[name]
        console.print(f"  {name}" + (f"  (or {', '.join(others)})" if others else ""))
    for group in found.groups:
        console.print(
            f"interchangeable: {', '.join(group.sensors)} (correlation {math.floor(100 * group.correlation) / 100:g} "
            "or more); "
            f"without all of them {group.without_um:.2f} µm ({found.more(group.without_um):+.1%})"
        )
    if best.fair_um is None:
        click.echo(
            "note: with two parts to leave out the sets are judged by what chose them, which flatters them", err=True
        )


def _worths(found: Selection, worths: tuple[Worth, ...], what: str, alone: str) -> Any:
    from rich.table import Table

    table = Table(what, title=f"what each {what} is worth", title_justify="left")
    for column in ("without it [µm]", "more left", f"{alone} [µm]"):
        table.add_column(column, justify="right")
    for w in sorted(worths, key=lambda w: -w.without_um):
        table.add_row(w.name, f"{w.without_um:.2f}", f"{found.more(w.without_um):+.1%}", f"{w.alone_um:.2f}")
    return table


def _curve(found: Selection) -> Any:
    from rich.table import Table

    table = Table("sensors", title="how many are needed", title_justify="left")
    for column in ("left [µm]", "fairly [µm]", "more left"):
        table.add_column(column, justify="right")
    table.add_column("set")
    before: set[str] | None = None
    for size in found.sizes:
        now = set(size.sensors)
        fair_um = size.left_um if size.fair_um is None else size.fair_um
        table.add_row(
            f"{len(now)}" + (" *" if size == found.best else ""),
            f"{size.left_um:.2f}",
            "" if size.fair_um is None else f"{size.fair_um:.2f}",
            f"{found.more(fair_um):+.1%}",
            _changed(now, before, found),
        )
        before = now
    table.caption = "fairly: by sets found without the measurements that they are judged on"
    return table


def _changed(now: set[str], before: set[str] | None, found: Selection) -> str:
    """Return the set in few words: what it adds to the smaller one, what it lacks, or all of it."""
    every = [w.name for w in found.sensors]
    missing = [name for name in every if name not in now]
    if before and before < now:
        return "+ " + ", ".join(name for name in every if name in now - before)
    if now and len(missing) < len(now):
        return f"all but {', '.join(missing)}" if missing else "all"
    return ", ".join(name for name in every if name in now) or "none"
