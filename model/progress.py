"""Progress of long work: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

Item = TypeVar("Item")

LINE_EVERY_S = 10.0
"""How often work without a terminal reports itself, so that logs stay short."""


class Reporter:
    """Shows how far some work has come; use it with `with`.

    Parameters
    ----------
    what : the work, in a word or two
    total : its steps
    """

    def __init__(self, what: str, total: int) -> None:
        self._what, self._total, self._done = what, total, 0
        self._shown_at = time.monotonic()
        self._bar: Progress | None = None
        if sys.stderr.isatty():
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
                TextColumn("{task.fields[note]}"),
                console=Console(stderr=True),
                transient=True,
            )
            self._task = self._bar.add_task(what, total=total, note="")

    def __enter__(self) -> Reporter:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, note: str = "") -> None:
        """Count one more step; `note` says something about it."""
        self.at(self._done + 1, self._total, note)

    def at(self, done: int, total: int, note: str = "") -> None:
        """Say how many steps are done, of how many by what is known now."""
        self._done, self._total = done, total
        if self._bar is not None:
            self._bar.update(self._task, completed=done, total=total, note=note)
        elif time.monotonic() - self._shown_at >= LINE_EVERY_S:
            self._shown_at = time.monotonic()
            print(f"{self._what}: {done} of {total} {note}".rstrip(), file=sys.stderr, flush=True)


def track(items: Sequence[Item], what: str) -> Iterator[Item]:
    """Yield the items and report how many are done."""
    with Reporter(what, len(items)) as reporter:
        for item in items:
            yield item
            reporter.advance()
