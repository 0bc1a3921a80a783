"""`thermotrue identify`: error terms from measured deviations."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from model.identify import Identification

PATH = click.Path(path_type=Path)
COVERED = 0.9
"""Part of an axis' range that must be measured for nothing to be said about it."""


@click.command()
@click.argument("machine", type=PATH)
@click.argument("measurements", type=PATH)
@click.option("--out", required=True, type=PATH, help="Error table to write, .csv.")
@click.option(
    "--degree", type=click.IntRange(0, 12), default=3, show_default=True, help="Polynomial degree of the motion terms."
)
@click.option("--terms", help="Terms to estimate, such as EXX,EYX,EC0Y; the others are zero. Default: all.")
@click.option("--tool", help="Name of the tool, where the machine has several.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def identify(
    machine: Path, measurements: Path, out: Path, degree: int, terms: str | None, tool: str | None, as_json: bool
) -> None:
    """Estimate error terms from measured deviations of the tool, and say what the measurement leaves open.

    MACHINE is a TOML file, a bundle or the name of a machine that comes with thermotrue. MEASUREMENTS has one column
    per axis and what was measured there, in the workpiece frame, actual minus nominal: dx_um, dy_um, dz_um, da_urad,
    db_urad, dc_urad, or dl_um along the direction nx, ny, nz. Cells may be empty. Optional columns: tool_length_mm,
    and sigma_um and sigma_urad or weight.

    Where several error terms explain the measurement equally well, the smallest are written, and named.
    """
    import json

    from model.chain import Chain
    from model.error_tables import write_error_table
    from model.exceptions import DataError
    from model.fields import Fields
    from model.identify import identify as estimate
    from model.machine_source import machine_at
    from model.measurements import read_measurements

    described = machine_at(machine)
    if out.suffix != ".csv":
        raise DataError(f"'{out}' must end in .csv, got '{out.suffix}'")
    wanted = {described.term(t).name for t in (terms.split(",") if terms else described.term_index)}
    fields = Fields(described, tuple(t for t in described.term_index if t in wanted), degree)
    found = estimate(Chain(described, tool), read_measurements(measurements, described), fields)
    write_error_table(out, found.rows())
    warnings = _warnings(found)
    if as_json:
        plain = {"machine": described.name, **_plain(found), "warnings": warnings}
        click.echo(json.dumps(plain, indent=2, ensure_ascii=False))
    else:
        _print(found)
        click.echo(f"{len(fields.terms)} terms written to {out}")
    for warning in warnings:
        click.echo(f"warning: {warning}", err=True)


def _warnings(found: Identification) -> list[str]:
    warnings = []
    if found.ambiguities.count:
        warnings.append(
            f"{found.ambiguities.count} combinations of coefficients are not determined; the table has the smallest "
            "errors that explain the measurement"
        )
    if found.equations <= found.rank:
        warnings.append("there are no spare measurements, so the residuals say nothing of the uncertainty")
    for name, (low, high) in found.spans.items():
        axis = found.fields.machine.axes[name]
        if high - low < COVERED * (axis.high - axis.low):
            warnings.append(
                f"axis {name} was measured from {low:g} to {high:g} {axis.unit} only; the table is constant beyond"
            )
    return warnings


def _plain(found: Identification) -> dict[str, Any]:
    spread = found.solution.spread
    open_ = found.ambiguities
    return {
        "equations": found.equations,
        "rank": found.rank,
        "residual_um": found.residual_um,
        "residual_urad": found.residual_urad,
        "spread": spread if spread == spread else None,  # noqa: PLR0124 (NaN)
        "terms": [
            {"term": t, "unit": found.fields.machine.term(t).unit, "rms": value, "standard_error": error}
            for t, (value, error) in ((t, found.summary(t)) for t in found.fields.terms)
        ],
        "coefficients": [
            {
                "name": c.name,
                "term": c.term,
                "degree": c.degree,
                "value": c.value,
                "standard_error": c.standard_error,
                "determined": c.determined,
            }
            for c in found.coefficients
        ],
        "undetermined": {
            "count": open_.count,
            "no_effect": [found.coefficients[k].name for k in open_.unseen],
            "same_effect": [_named(found, group) for group in open_.alike],
            "only_combined": [_named(found, trade) for trade in open_.combined],
        },
    }


def _named(found: Identification, amounts: dict[int, float]) -> dict[str, float]:
    return {found.coefficients[k].name: amount for k, amount in amounts.items()}


def _print(found: Identification) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("term", title="error terms over the measured range", title_justify="left")
    for column in ("rms", "standard error"):
        table.add_column(column, justify="right")
    table.add_column("not determined by itself")
    for term in found.fields.terms:
        value, error = found.summary(term)
        unit = "µrad" if found.fields.machine.term(term).angular else "µm"
        mine = [c for c in found.coefficients if c.term == term]
        vague = [c.name.removeprefix(f"{term}'s ") for c in mine if not c.determined]
        table.add_row(
            term,
            f"{value:.3f} {unit}",
            "-" if error is None else f"{error:.3f} {unit}",
            "all" if len(vague) == len(mine) else ", ".join(vague),
        )
    console = Console(highlight=False)
    console.print(table)
    for what, rms, unit in (("displacements", found.residual_um, "µm"), ("angles", found.residual_urad, "µrad")):
        if rms is not None:
            console.print(f"residual of {what}: {rms:.3f} {unit} rms")
    console.print(
        f"{found.equations} measured numbers determine {found.rank} combinations of {len(found.coefficients)} "
        "coefficients"
    )
    for sentence in _sentences(found):
        click.echo(sentence)


def _sentences(found: Identification) -> list[str]:
    """Return in words what the measurement cannot tell apart."""
    names = [c.name for c in found.coefficients]
    unseen = found.ambiguities.unseen
    sentences = []
    if unseen:
        whole = [t for t, where in found.fields.slices().items() if set(range(where.start, where.stop)) <= {*unseen}]
        parts = [names[k] for k in unseen if found.coefficients[k].term not in whole]
        sentences.append(f"without effect on the measurement: {_listed([*whole, *parts])}")
    sentences += [f"with the same effect: {_listed(names[k] for k in group)}" for group in found.ambiguities.alike]
    sentences += [f"only in combination: {_listed(names[k] for k in trade)}" for trade in found.ambiguities.combined]
    return sentences


def _listed(names: Iterable[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
