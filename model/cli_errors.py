"""`thermotrue deviation` and `thermotrue compensate`: the chain with static error tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

PATH = click.Path(path_type=Path)
errors_option = click.option(
    "--errors", required=True, type=PATH, help="Error table: term, position, value [µm or µrad]."
)
positions_option = click.option(
    "--positions", required=True, type=PATH, help="Positions: one column per axis [mm, degree]."
)
out_option = click.option("--out", required=True, type=PATH, help="File to write, .csv or .parquet.")
tool_option = click.option("--tool-length", type=float, help="Tool length [mm]; default: the machine's tool offset.")
relative_option = click.option(
    "--relative-to",
    type=click.Choice(["body", "tool"]),
    default="body",
    show_default=True,
    help="What the error table says: a body against its lower body, or, as instruments do, the tool against the "
    "workpiece (taken as measured at each body's origin: signs change, levers do not).",
)
spindle_option = click.option("--tool", help="Name of the tool leaf, where the machine has several.")


@click.command()
@click.argument("machine", type=PATH)
@errors_option
@positions_option
@out_option
@tool_option
@spindle_option
@relative_option
@click.option("--small-angle", is_flag=True, help="Use the small-angle transforms of eq. (3) and not the exact ones.")
def deviation(
    machine: Path,
    errors: Path,
    positions: Path,
    out: Path,
    tool_length: float | None,
    tool: str | None,
    relative_to: str,
    small_angle: bool,
) -> None:
    """Write where the tool tip really is, less where it should be.

    MACHINE is a TOML file or a bundle. The output has the positions with dx_um, dy_um, dz_um, da_urad, db_urad,
    dc_urad: actual minus nominal, in the workpiece frame.
    """
    from model.positions import coordinates
    from model.streams import Chunk, transform
    from model.terms import UM, URAD

    chain, error_map, tool_mm = _prepare(machine, errors, tool_length, tool, relative_to)

    def deviations(chunk: Chunk) -> dict[str, Any]:
        q = coordinates(chunk, chain.machine)
        found = chain.deviation(q, error_map.evaluate(q), tool_mm, "small-angle" if small_angle else "exact")
        columns = {f"d{a}_um": found.position_mm[:, i] / UM for i, a in enumerate("xyz")}
        return columns | {f"d{a}_urad": found.orientation_rad[:, i] / URAD for i, a in enumerate("abc")}

    rows = transform(positions, out, chain.machine.axis_names, deviations, "deviation", keep=(machine, errors))
    click.echo(f"{rows} positions written to {out}")


@click.command()
@click.argument("machine", type=PATH)
@errors_option
@positions_option
@out_option
@tool_option
@spindle_option
@relative_option
@click.option("--keep", default="", help="Axes that must stay as programmed, separated by commas, such as A,C.")
def compensate(
    machine: Path,
    errors: Path,
    positions: Path,
    out: Path,
    tool_length: float | None,
    tool: str | None,
    relative_to: str,
    keep: str,
) -> None:
    """Write the coordinates to command so that the tool ends up at the positions asked for.

    MACHINE is a TOML file or a bundle. The output has the positions with X_corrected ..., which put the tip in its
    place to 1 nm of the exact chain, and tilt_urad: the angle of the tool axis that the machine has no rotary axis to
    remove, or too little of one near a singular pose.
    """
    from model.compensation import RESIDUAL_MM, Compensator
    from model.positions import coordinates
    from model.streams import Chunk, transform
    from model.terms import UM, URAD

    chain, error_map, tool_mm = _prepare(machine, errors, tool_length, tool, relative_to)
    kept = [name.strip() for name in keep.split(",") if name.strip()]
    compensator = Compensator(chain, error_map, tool_mm, kept)
    outside = first_outside = 0
    furthest_mm = 0.0

    def corrections(chunk: Chunk) -> dict[str, Any]:
        nonlocal outside, first_outside, furthest_mm
        found = compensator.compensate(coordinates(chunk, chain.machine))
        furthest_mm = max(furthest_mm, float(found.residual_mm.max(initial=0.0)))
        if found.outside.any():
            first_outside = first_outside or chunk.first + int(found.outside.argmax()) + 1
            outside += int(found.outside.sum())
        columns = {f"{a}_corrected": found.corrected[:, i] for i, a in enumerate(chain.machine.axis_names)}
        return columns | {"tilt_urad": found.tilt_rad / URAD}

    rows = transform(positions, out, chain.machine.axis_names, corrections, "compensation", keep=(machine, errors))
    click.echo(f"{rows} positions written to {out}")
    if outside:
        click.echo(
            f"warning: {outside} corrected positions leave an axis' range, the first in row {first_outside}; they are "
            "written as they are",
            err=True,
        )
    if furthest_mm > RESIDUAL_MM:
        click.echo(
            f"warning: the free axes do not reach every direction; the tip stays up to {furthest_mm / UM:.3g} µm away",
            err=True,
        )


def _prepare(
    machine: Path, errors: Path, tool_length: float | None, tool: str | None, relative_to: str
) -> tuple[Any, ...]:
    import math

    import numpy as np

    from model.bundle import machine_of
    from model.chain import Chain
    from model.error_map import ErrorMap
    from model.error_tables import read_error_table
    from model.exceptions import DataError
    from model.relative_to import to_body

    described = machine_of(machine)
    rows = read_error_table(errors)
    if relative_to == "tool":
        rows = to_body(described, rows)
    error_map = ErrorMap.from_rows(described, rows, f"'{errors}'")
    tool_mm = None
    if tool_length is not None:
        if not math.isfinite(tool_length):
            raise DataError(f"--tool-length must be a finite number of mm, got {tool_length}")
        tool_mm = tool_length * np.asarray(described.tool.direction)
    return Chain(described, tool), error_map, tool_mm
