"""Scores as a table for people."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console
from rich.table import Table

from training.evaluation import NO_COMPENSATION, Score
from training.interval import Interval


def print_scores(scores: Mapping[str, Score], title: str) -> None:
    """Print the methods side by side, and run by run where there are several runs."""
    console = Console(width=None if Console().is_terminal else 100)
    table = Table(title=title, title_justify="left")
    table.add_column("residual at the tool tip")
    for column in ("RMS [µm]", "share left", "worst [µm]"):
        table.add_column(column, justify="right")
    for name, score in scores.items():
        table.add_row(name, f"{score.rms_um:.2f}", f"{score.share:.1%}", f"{score.worst_um:.1f}")
    console.print(table)
    runs = list(scores[NO_COMPENSATION].by_run_um)
    if len(runs) < 2:
        return
    by_run = Table(title="RMS [µm] run by run", title_justify="left")
    by_run.add_column("run", min_width=min(max(map(len, runs)), 24), overflow="fold")
    for name in scores:
        by_run.add_column(name, justify="right", overflow="fold")
    for run in runs:
        by_run.add_row(run, *(f"{score.by_run_um[run]:.2f}" for score in scores.values()))
    console.print(by_run)


def print_interval(interval: Interval) -> None:
    """Print how the network's 95 % interval did, and run by run where there are several runs."""
    console = Console(width=None if Console().is_terminal else 100)
    table = Table(title="the network's 95 % interval at the tip, in x, y and z", title_justify="left")
    table.add_column("run")
    for column in ("deviations within", "allowed, mean [µm]"):
        table.add_column(column, justify="right")
    by_run = interval.by_run if len(interval.by_run) > 1 else {}
    for name, one in {**by_run, "all" if by_run else next(iter(interval.by_run), "all"): interval}.items():
        table.add_row(name, f"{one.within:.1%}", f"± {one.half_width_um:.1f}")
    console.print(table)
