"""Scores as a table for people."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console
from rich.table import Table

from training.evaluation import NO_COMPENSATION, Score


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
    by_run.add_column("run")
    for name in scores:
        by_run.add_column(name, justify="right")
    for run in runs:
        by_run.add_row(run, *(f"{score.by_run_um[run]:.2f}" for score in scores.values()))
    console.print(by_run)
