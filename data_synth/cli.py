"""The command `thermotrue synth`."""

from __future__ import annotations

import json
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

if TYPE_CHECKING:
    from data_synth.estimate import Estimate
    from data_synth.recipe import Recipe
    from data_synth.run import Shop
    from data_synth.summary import RunSummary


class SynthCommand(click.Command):
    """A command whose help ends with what the shop knows."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the names of machines, duty cycles, climates and faults."""
        with suppress(ModuleNotFoundError):  # SciPy comes with the train extra
            from data_synth.climates import CLIMATES
            from data_synth.cycles import NAMES, describe
            from data_synth.faults import KINDS
            from data_synth.machines import DESIGNS

            with formatter.section("Duty cycles"):
                formatter.write_dl([(name, describe(name)) for name in NAMES])
            for what, names in (("Machines", [*DESIGNS]), ("Climates", [*CLIMATES]), ("Faults", [*KINDS])):
                with formatter.section(what):
                    formatter.write_text(", ".join(names))


@click.command(cls=SynthCommand, short_help="make a synthetic data set")
@click.option("--machine", required=True, metavar="NAME|FILE", help="A machine the shop knows; vmc3~1 is a sibling.")
@click.option("--runs", default=24, show_default=True, help="Number of runs, each with its duty cycle.")
@click.option("--hours", default=12.0, show_default=True, help="Length of each run.")
@click.option("--seed", default=0, show_default=True, help="The same seed gives the same data, byte for byte.")
@click.option("--out", required=True, type=click.Path(path_type=Path), metavar="DATASET", help="Folder to make.")
@click.option("--format", "form", type=click.Choice(["parquet", "csv"]), default="parquet", show_default=True)
@click.option("--cycles", "named", metavar="A,B,..", help="Duty cycles of the runs in turn; default: a mixture.")
@click.option("--climate", metavar="NAME", help="The hall around all runs, instead of each duty cycle's own.")
@click.option("--period", default=60.0, show_default=True, metavar="SECONDS", help="Between two rows of telemetry.")
@click.option("--faults", metavar="KIND[=N],..|all", help="Spoil readings and label them; N in 100 hours of a sensor.")
@click.option("--tool-tip", is_flag=True, help="Let a touch probe measure the tip's deviation on the way.")
@click.option("--workers", type=click.IntRange(min=1), help="Processes.  [default: all cores, one for a small set]")
@click.option("--pictures/--no-pictures", default=True, help="Draw for the data card.  [default: draw]")
@click.option("--force", is_flag=True, help="Replace the data set that is there.")
@click.option("--dry-run", is_flag=True, help="Say what would be made, how large and in what time, and make nothing.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def synth(
    machine: str,
    runs: int,
    hours: float,
    seed: int,
    out: Path,
    form: Literal["parquet", "csv"],
    named: str | None,
    climate: str | None,
    period: float,
    faults: str | None,
    tool_tip: bool,
    workers: int | None,
    pictures: bool,
    force: bool,
    dry_run: bool,
    as_json: bool,
) -> None:
    """Run a machine in a synthetic shop: what its sensors show, how its error terms drift."""
    from data_synth import cycles
    from data_synth.dataset import check_folder, write_dataset
    from data_synth.estimate import estimate, usual_workers
    from data_synth.faults import parse
    from data_synth.machines import open_shop
    from data_synth.recipe import Recipe
    from model.progress import track

    shop = open_shop(machine)
    order = cycles.order(shop.machine) if named is None else tuple(name.strip() for name in named.split(","))
    asked = None if faults is None else parse(faults)
    recipe = Recipe(runs, hours, seed, order, period, climate, asked, tool_tip)
    recipe.check(shop.machine)
    workers = workers or usual_workers(recipe)
    if dry_run:
        check_folder(out, force)
        found = estimate(shop, recipe, form, workers, pictures)
        click.echo(json.dumps(_planned(shop, recipe, out, found)) if as_json else _plan(shop, recipe, out, form, found))
        return
    summaries = write_dataset(shop, recipe, out, form, force, partial(track, what="runs"), workers, pictures)
    click.echo(json.dumps(_facts(shop, recipe, out, summaries)) if as_json else _line(shop, recipe, out, summaries))


def _line(shop: Shop, recipe: Recipe, out: Path, summaries: list[RunSummary]) -> str:
    from data_synth.summary import total_drift_um

    return (
        f"{out}: {len(summaries)} runs of {recipe.hours:g} h of {shop.machine.name}, seed {recipe.seed}; "
        f"the tool tip drifts by {total_drift_um(summaries):.0f} µm rms, "
        f"{max(s.furthest_um for s in summaries):.0f} µm at most"
    )


def _plan(shop: Shop, recipe: Recipe, out: Path, form: str, found: Estimate) -> str:
    taken = [recipe.kind(i) for i in range(recipe.runs)]
    counted = ", ".join(f"{taken.count(name)} {name}" for name in dict.fromkeys(taken))
    processes = "1 process" if found.workers == 1 else f"{found.workers} processes"
    return "\n".join(
        (
            f"{out}: {recipe.runs} runs of {recipe.hours:g} h of {shop.machine.name}, seed {recipe.seed}; not made",
            f"runs: {counted}",
            "rows: " + ", ".join(f"{rows:,} of {table}" for table, rows in found.rows.items()),
            f"about {found.size / 1e6:.3g} MB of {form}, in about {max(found.seconds, 1.0):.2g} s with {processes}",
        )
    )


def _facts(shop: Shop, recipe: Recipe, out: Path, summaries: list[RunSummary]) -> dict[str, Any]:
    from data_synth.summary import total_drift_um

    return {
        **_asked(shop, recipe, out),
        "made": True,
        "rows": recipe.rows(shop)
        | ({"faults": sum(sum(s.faults.values()) for s in summaries)} if recipe.faults else {}),
        "size_bytes": sum(file.stat().st_size for file in out.iterdir()),
        "drift_um": round(total_drift_um(summaries), 3),
        "furthest_um": round(max(s.furthest_um for s in summaries), 3),
        "runs": [
            {
                "name": s.name,
                "cycle": recipe.kind(i),
                "drift_um": round(s.drift_um, 3),
                "furthest_um": round(s.furthest_um, 3),
                "furthest_s": s.furthest_s,
                "faults": s.faults,
            }
            for i, s in enumerate(summaries)
        ],
    }


def _planned(shop: Shop, recipe: Recipe, out: Path, found: Estimate) -> dict[str, Any]:
    return {
        **_asked(shop, recipe, out),
        "made": False,
        "rows": found.rows,
        "size_bytes": found.size,
        "seconds": float(f"{found.seconds:.2g}"),
        "workers": found.workers,
        "runs": [{"name": recipe.name(i), "cycle": recipe.kind(i)} for i in range(recipe.runs)],
    }


def _asked(shop: Shop, recipe: Recipe, out: Path) -> dict[str, Any]:
    return {
        "dataset": str(out),
        "machine": shop.machine.name,
        "seed": recipe.seed,
        "hours": recipe.hours,
        "period_s": recipe.period_s,
        "terms_period_s": recipe.terms_period_s,
    }
