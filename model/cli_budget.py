"""`thermotrue budget`: rank the error terms by what they do to the tool tip."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from model.term_classes import TermClass

if TYPE_CHECKING:
    from model.budget import Budget

PATH = click.Path(path_type=Path)
CLASSES: tuple[TermClass, ...] = ("principal", "secondary")


@click.command()
@click.argument("machine", type=PATH)
@click.option("--errors", type=PATH, help="Error table: term, position, value [µm or µrad].")
@click.option("--tool-length", type=float, help="Tool length [mm]; default: the machine's tool offset.")
@click.option("--tool", help="Name of the tool, where the machine has several.")
@click.option("--points", type=click.IntRange(1, 1_000_000), default=4096, show_default=True, help="Sampled positions.")
@click.option(
    "--location-share",
    type=click.FloatRange(0.0, 1.0),
    default=0.005,
    show_default=True,
    help="Without --errors: secondary location terms relative to the others.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the budget as JSON.")
@click.option("--picture", type=PATH, help="Draw the budget into this file, such as budget.png.")
def budget(
    machine: Path,
    errors: Path | None,
    tool_length: float | None,
    tool: str | None,
    points: int,
    location_share: float,
    as_json: bool,
    picture: Path | None,
) -> None:
    """Rank the error terms by the tip deviation that each makes over the working volume.

    MACHINE is a TOML file, a bundle or the name of a machine that comes with thermotrue. With an error table the
    terms have its values. Without one they are independent uncertainties: 10 µm and 10 µrad of each principal term,
    and a small share of that of each secondary location term.

    "rms alone" is the displacement that a term makes by itself. "share" is its part of the mean square of the whole;
    with a table it counts signs, and is negative for a term that makes up for others. The shares add up to 100 %.
    """
    import json

    from model.budget import budget as rank
    from model.chain import Chain
    from model.error_map import ErrorMap
    from model.error_tables import read_error_table
    from model.machine_source import machine_at, tool_tip

    described = machine_at(machine)
    chain = Chain(described, tool)
    table = None if errors is None else ErrorMap.from_rows(described, read_error_table(errors), f"'{errors}'")
    found = rank(chain, table, tool_mm=tool_tip(described, tool_length), points=points, location_share=location_share)
    basis = "unit uncertainties" if errors is None else f"the error table '{errors}'"
    if picture is not None:
        from model.pictures import draw_budget

        draw_budget(picture, found, f"{described.name}: error budget from {basis}")
    if as_json:
        click.echo(json.dumps({"machine": described.name, "from": basis, **_plain(found)}, indent=2))
        return
    _print(found, described.name, basis)


def _plain(found: Budget) -> dict[str, Any]:
    return {
        "tip_um": found.tip_um,
        "tilt_urad": found.tilt_urad,
        "classes": {name: {"count": found.count(name), "share": found.share(name)} for name in CLASSES},
        "terms": [
            {
                "term": c.term.name,
                "class": c.term_class,
                "size": c.size,
                "unit": c.term.unit,
                "tip_um": c.tip_um,
                "tilt_urad": c.tilt_urad,
                "share": c.share,
            }
            for c in found.contributions
        ],
    }


def _print(found: Budget, name: str, basis: str) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("term", "class", title=f"error budget of '{name}' from {basis}", title_justify="left")
    for column in ("size", "rms alone [µm]", "share [%]", "tool tilt [µrad]"):
        table.add_column(column, justify="right")
    for c in found.contributions:
        unit = "µrad" if c.term.angular else "µm"
        table.add_row(
            c.term.name,
            c.term_class,
            f"{c.size:.4g} {unit}",
            f"{c.tip_um:.3f}",
            f"{100 * c.share:.2f}",
            f"{c.tilt_urad:.2f}",
        )
    console = Console(highlight=False)
    console.print(table)
    console.print(f"all terms together: {found.tip_um:.3f} µm at the tip, {found.tilt_urad:.2f} µrad of the tool")
    for kind in CLASSES:
        console.print(f"{found.count(kind)} {kind} terms make {100 * found.share(kind):.3f} % of the mean square")
