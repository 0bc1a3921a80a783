"""`thermotrue describe`: show what a machine description says."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from rich.table import Table
    from rich.tree import Tree

PATH = click.Path(path_type=Path)


@click.command()
@click.argument("machine", type=PATH)
@click.option("--json", "as_json", is_flag=True, help="Print the description as JSON.")
@click.option("--picture", type=PATH, help="Draw the chain into this file, such as chain.png.")
def describe(machine: Path, as_json: bool, picture: Path | None) -> None:
    """Show a machine's bodies, lower-body array, axes and error terms.

    MACHINE is a TOML file, a bundle or the name of a machine that comes with thermotrue, such as seed3.
    """
    import json

    from rich.console import Console

    from model.describe import describe_machine
    from model.machine_source import machine_at

    found = machine_at(machine)
    facts = describe_machine(found)
    if picture is not None:
        from model.pictures import draw_chain

        draw_chain(picture, found)
    if as_json:
        click.echo(json.dumps(facts, indent=2, ensure_ascii=False))
        return
    console = Console(highlight=False)
    console.print(f"machine '{found.name}', composition {found.composition}\n")
    for part in (_tree(facts), _lower_bodies(facts), _axes(facts), _terms(facts)):
        console.print(part)
        console.print()
    principal = sum(t["class"] == "principal" for t in facts["terms"])
    console.print(
        f"{len(facts['terms'])} error terms: {principal} principal, {len(facts['terms']) - principal} secondary"
    )


def _tree(facts: dict[str, Any]) -> Tree:
    from rich.tree import Tree

    from model.describe import direction_text

    carries: dict[int, list[str]] = {facts["workpiece_on"]: ["workpiece"]}
    for name, number in facts["tools_on"].items():
        carries.setdefault(number, []).append(name)
    nodes: dict[int, Tree] = {}
    for body in facts["bodies"]:
        text = f"{body['number']} {body['name']}"
        if body["axis"]:
            axis = facts["axes"][body["axis"]]
            motion = "turns about" if axis["kind"] == "rotary" else "moves along"
            text += f": {motion} {direction_text(axis['direction'])}"
        elif body["lower"]:
            text += ": fixed"
        carried = [c for c in carries.get(body["number"], []) if c != body["name"]]
        text += f", carries {' and '.join(carried)}" if carried else ""
        nodes[body["number"]] = nodes[body["lower"]].add(text) if body["lower"] else Tree(text)
    return nodes[1]


def _lower_bodies(facts: dict[str, Any]) -> Table:
    from rich.table import Table

    table = Table(title="lower-body array", title_justify="left")
    table.add_column("body j")
    for body in facts["bodies"]:
        table.add_column(f"{body['number']} {body['name']}", justify="right")
    for n, row in enumerate(facts["lower_body_powers"]):
        table.add_row(f"L^{n}(j)", *map(str, row))
    return table


def _axes(facts: dict[str, Any]) -> Table:
    from rich.table import Table

    from model.describe import direction_text

    table = Table("axis", "side", "range", "direction", "origin [mm]", title="axes", title_justify="left")
    for name, axis in facts["axes"].items():
        low, high = axis["range"]
        table.add_row(
            name,
            axis["side"],
            f"{low:g} ... {high:g} {axis['unit']}",
            direction_text(axis["direction"]),
            ", ".join(f"{v:g}" for v in axis["origin_mm"]),
        )
    return table


def _terms(facts: dict[str, Any]) -> Table:
    from rich.table import Table

    table = Table("term", "meaning", "kind", "class", "unit", title="error terms", title_justify="left")
    for term in facts["terms"]:
        unit = "µrad" if term["unit"] == "urad" else "µm"
        table.add_row(term["name"], term["meaning"], term["kind"], term["class"], unit)
    return table
