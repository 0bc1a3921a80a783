"""`thermotrue deviation` and `thermotrue compensate`: the chain with static error tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

PATH = click.Path(path_type=Path)
errors_option = click.option(
    "--errors", required=True, type=PATH, help="Error table: term, position, value [µm or µrad]."
)
positions_option = click.option("--positions", required=True, type=PATH, help="Positions: one column per axis [mm].")
out_option = click.option("--out", required=True, type=PATH, help="File to write, .csv or .parquet.")
tool_option = click.option("--tool-length", type=float, help="Tool length [mm]; default: the machine's tool offset.")


@click.command()
@click.argument("machine", type=PATH)
@errors_option
@positions_option
@out_option
@tool_option
@click.option("--small-angle", is_flag=True, help="Use the small-angle transforms of eq. (3) and not the exact ones.")
def deviation(
    machine: Path, errors: Path, positions: Path, out: Path, tool_length: float | None, small_angle: bool
) -> None:
    """Write where the tool tip really is, less where it should be.

    MACHINE is a TOML file or a bundle. The output has the positions with dx_um, dy_um, dz_um, da_urad, db_urad,
    dc_urad: actual minus nominal, in the workpiece frame.
    """
    from model.terms import UM, URAD

    chain, table, q, error_map, tool_mm = _prepare(machine, errors, positions, tool_length)
    found = chain.deviation(q, error_map.evaluate(q), tool_mm, "small-angle" if small_angle else "exact")
    columns = {f"d{a}_um": found.position_mm[:, i] / UM for i, a in enumerate("xyz")}
    columns |= {f"d{a}_urad": found.orientation_rad[:, i] / URAD for i, a in enumerate("abc")}
    _write(out, table, columns)


@click.command()
@click.argument("machine", type=PATH)
@errors_option
@positions_option
@out_option
@tool_option
def compensate(machine: Path, errors: Path, positions: Path, out: Path, tool_length: float | None) -> None:
    """Write the coordinates to command so that the tool tip ends up at the positions asked for.

    MACHINE is a TOML file or a bundle. The output has the positions with X_corrected ..., to 1 nm of the exact
    chain.
    """
    from model.compensation import compensate as solve

    chain, table, q, error_map, tool_mm = _prepare(machine, errors, positions, tool_length)
    found = solve(chain, q, error_map, tool_mm)
    _write(out, table, {f"{a}_corrected": found.corrected[:, i] for i, a in enumerate(chain.machine.axis_names)})
    if found.outside.any():
        first = int(found.outside.argmax())
        click.echo(
            f"warning: {int(found.outside.sum())} corrected positions leave an axis' range, the first in row "
            f"{first + 1}; they are written as they are",
            err=True,
        )


def _prepare(machine: Path, errors: Path, positions: Path, tool_length: float | None) -> tuple[Any, ...]:
    import math

    import numpy as np

    from model.bundle import machine_of
    from model.chain import Chain
    from model.error_map import ErrorMap
    from model.error_tables import read_error_table
    from model.exceptions import DataError
    from model.positions import read_positions

    described = machine_of(machine)
    table, q = read_positions(positions, described)
    error_map = ErrorMap.from_rows(described, read_error_table(errors), f"'{errors}'")
    tool_mm = None
    if tool_length is not None:
        if not math.isfinite(tool_length):
            raise DataError(f"--tool-length must be a finite number of mm, got {tool_length}")
        tool_mm = tool_length * np.asarray(described.tool.direction)
    return Chain(described), table, q, error_map, tool_mm


def _write(out: Path, table: Any, columns: dict[str, Any]) -> None:
    from model.tables import write_table

    write_table(out, {**table.text, **table.numbers, **columns})
    click.echo(f"{len(table)} positions written to {out}")
