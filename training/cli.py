"""`thermotrue train` and `thermotrue evaluate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from model.exceptions import ThermotrueError

if TYPE_CHECKING:
    from training.plan import Plan

PATH = click.Path(path_type=Path)


def _names(_ctx: click.Context, _option: click.Parameter, value: str | None) -> list[str] | None:
    return None if value is None else value.split(",")


@click.command()
@click.argument("dataset", type=PATH)
@click.option("--out", required=True, type=PATH, help="Bundle folder to write; an older bundle there is replaced.")
@click.option(
    "--test-runs",
    callback=_names,
    help="Runs to leave out of training and of the bundle, separated by commas. By default a fifth of the runs "
    "(of a single run: the last spindle phase) is left out to measure the network, which is then trained on all.",
)
@click.option(
    "--from",
    "start",
    type=PATH,
    help="Bundle of a like machine, of a series or synthetic, whose network to start from where that helps.",
)
@click.option("--seed", default=0, show_default=True, help="Of the split and the network's first weights.")
@click.option("--picture", type=PATH, help="Draw the test run that drifts most, as measured and predicted.")
@click.option("--report/--no-report", default=True, help="Write a page about the training beside the bundle: OUT.html.")
@click.option(
    "--baselines",
    is_flag=True,
    help="Measure the network beside all baselines: ARX, boosted trees and a GRU, too, which take a minute or more.",
)
@click.option("--fresh", is_flag=True, help="Start anew, where an interrupted training left OUT.checkpoint.")
@click.option("--dry-run", is_flag=True, help="Check the data, say what would be done, and do nothing.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def train(
    dataset: Path,
    out: Path,
    test_runs: list[str] | None,
    start: Path | None,
    seed: int,
    picture: Path | None,
    report: bool,
    baselines: bool,
    fresh: bool,
    dry_run: bool,
    as_json: bool,
) -> None:
    """Train a thermal network on the data set folder DATASET and write a bundle that `thermotrue serve` takes.

    Prints what the network, baselines and no compensation leave of the tool tip's deviation on measurements it was
    not trained on. What is done is kept in OUT.checkpoint: after Ctrl-C or a kill the same command goes on.
    """
    from training.baselines.everyone import BASELINES
    from training.checkpoint import Checkpoint, checkpoint_path
    from training.job import train_bundle
    from training.plan import FAST, plan_training
    from training.report import check_report, report_path, write_report

    _check_picture(picture)
    page = report_path(out) if report else None
    if page is not None:
        check_report(page)
    beside = BASELINES if baselines else FAST
    checkpoint = Checkpoint(checkpoint_path(out), fresh=fresh)
    if dry_run:
        _print_plan(plan_training(dataset, out, test_runs, seed, start, beside), as_json)
        return
    try:
        result = train_bundle(dataset, out, test_runs, seed, start, checkpoint, beside)
        if picture is not None:
            result.draw(picture)
        if page is not None:
            write_report(result, page)
    except KeyboardInterrupt:
        raise click.Abort(checkpoint.leave()) from None
    except ThermotrueError:
        checkpoint.leave()
        raise
    checkpoint.remove()
    if as_json:
        _print_json({**result.as_dict(), "report": None if page is None else str(page)})
        return
    from training.tables import print_scores

    print_scores(result.scores, f"{result.machine}, left out: {result.left_out}")
    _print_note(result.note)
    click.echo(result.summary())
    if page is not None:
        click.echo(f"report {page}")


@click.command()
@click.argument("bundle", type=PATH)
@click.argument("dataset", type=PATH)
@click.option("--runs", callback=_names, help="Runs to test on, separated by commas; by default all.")
@click.option(
    "--baselines",
    is_flag=True,
    help="Train what one would use instead of the network (ridge regressions, ARX, boosted trees, a GRU), each with "
    "its settings chosen on its training data, and print all in one table.",
)
@click.option(
    "--train-on",
    type=PATH,
    help="Data set to train the baselines on; by default the runs of DATASET that are not tested on.",
)
@click.option("--picture", type=PATH, help="Draw the one that drifts most, as measured and predicted.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def evaluate(
    bundle: Path,
    dataset: Path,
    runs: list[str] | None,
    baselines: bool,
    train_on: Path | None,
    picture: Path | None,
    as_json: bool,
) -> None:
    """Measure what the network of BUNDLE leaves of the tool tip's deviation on runs of DATASET."""
    from training.job import evaluate_bundle

    if train_on is not None and not baselines:
        raise click.UsageError("--train-on says what to train the baselines on; give --baselines, too")
    _check_picture(picture)
    result = evaluate_bundle(bundle, dataset, runs)
    more = None
    if baselines:
        from training.comparison import with_baselines

        more = with_baselines(result, train_on)
        result = more.result
    if picture is not None:
        result.draw(picture)
    if as_json:
        _print_json(result.as_dict() if more is None else more.as_dict())
        return
    from training.tables import print_interval, print_scores

    print_scores(result.scores, f"{result.machine}, {result.left_out}")
    _print_note(result.note)
    if result.interval is not None:
        print_interval(result.interval)
    if result.seen:
        click.echo(f"note: the bundle was trained on {', '.join(result.seen)}, so these figures flatter it", err=True)
    if more is not None:
        click.echo(more.summary())


def _print_plan(plan: Plan, as_json: bool) -> None:
    if as_json:
        _print_json(plan.as_dict())
        return
    for sentence in plan.sentences():
        click.echo(sentence)
    for notice in (plan.note, *plan.notices):
        _print_note(notice)


def _check_picture(path: Path | None) -> None:
    if path is not None:
        from training.picture import check_picture

        check_picture(path)


def _print_note(note: str) -> None:
    if note:
        click.echo(f"note: {note}", err=True)


def _print_json(data: dict[str, Any]) -> None:
    import json

    click.echo(json.dumps(data, indent=1, allow_nan=False))
