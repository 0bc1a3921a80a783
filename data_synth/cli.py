"""The command `thermotrue synth`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Literal

import click


@click.command(short_help="make a synthetic data set")
@click.option("--machine", required=True, metavar="NAME|FILE", help="A machine the shop knows, such as vmc3.")
@click.option("--runs", default=24, show_default=True, help="Number of runs, each with its duty cycle.")
@click.option("--hours", default=12.0, show_default=True, help="Length of each run.")
@click.option("--seed", default=0, show_default=True, help="The same seed gives the same data, byte for byte.")
@click.option("--out", required=True, type=click.Path(path_type=Path), metavar="DATASET", help="Folder to make.")
@click.option("--format", "form", type=click.Choice(["parquet", "csv"]), default="parquet", show_default=True)
@click.option("--force", is_flag=True, help="Replace the data set that is there.")
def synth(
    machine: str, runs: int, hours: float, seed: int, out: Path, form: Literal["parquet", "csv"], force: bool
) -> None:
    """Run a machine in a synthetic shop: what its sensors show, how its error terms drift."""
    from data_synth.card import total_drift_um
    from data_synth.dataset import make_dataset
    from data_synth.machines import open_shop
    from model.progress import track

    shop = open_shop(machine)
    summaries = make_dataset(shop, runs, hours, seed, out, form, force, partial(track, what="runs"))
    click.echo(
        f"{out}: {len(summaries)} runs of {hours:g} h of {shop.machine.name}, seed {seed}; "
        f"the tool tip drifts by {total_drift_um(summaries):.0f} µm rms, "
        f"{max(s.furthest_um for s in summaries):.0f} µm at most"
    )
