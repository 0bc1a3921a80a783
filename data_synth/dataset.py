"""Make a whole data set: runs, cold errors, data card, picture; the folder appears when all of it is there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from data_synth.card import RunSummary, card
from data_synth.geometric import geometry
from data_synth.picture import draw
from data_synth.run import TERMS_PERIOD_S, Shop, run_kind, run_name, simulate
from data_synth.tip import tip_deviation
from data_synth.writer import DataSetWriter, Format
from model.exceptions import InputError

GEOMETRY_STREAM = 2**32 - 1
"""Beside the seed, where a run has its number."""
SHORTEST_H = 2 * TERMS_PERIOD_S / 3600.0
LONGEST_H = 1000.0  # some 100 MB


def make_dataset(
    shop: Shop,
    runs: int,
    hours: float,
    seed: int,
    out: Path,
    form: Format = "parquet",
    replace: bool = False,
    track: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> list[RunSummary]:
    """Write a data set into the folder `out` and return a summary of each run.

    Parameters
    ----------
    replace : whether a data set that is there already may go
    track : wraps the numbers of the runs, to show progress

    Raises
    ------
    InputError
        where the folder is in use, or the numbers make no data set.
    """
    _check(runs, hours, seed)
    summaries: list[RunSummary] = []
    with _new_folder(out, replace) as folder:
        cold = geometry(shop.machine, np.random.default_rng((seed, GEOMETRY_STREAM)), shop.design.workmanship)
        with DataSetWriter(folder, shop.machine, cold, form) as writer:
            for i in track(range(runs)):
                run = simulate(shop, run_name(i), run_kind(i), (seed, i), hours)
                deviation = tip_deviation(shop.machine, run.terms)
                writer.write(run)
                summaries.append(RunSummary.of(run, deviation))
                if i == 0:
                    middle = deviation[:, deviation.shape[1] // 2]
                    draw(folder / "overview.png", shop.machine.name, run, middle - middle[:1])
        command = f"thermotrue synth --machine {shop.machine.name} --runs {runs} --hours {hours:g} --seed {seed}"
        text = card(shop.design, tuple(shop.machine.sensors), summaries, seed, hours, f"{command} --format {form}")
        (folder / "README.md").write_text(text, encoding="utf-8", newline="\n")
    return summaries


def _check(runs: int, hours: float, seed: int) -> None:
    if runs < 1:
        raise InputError(f"runs must be at least 1, got {runs}")
    if not 0 <= seed < GEOMETRY_STREAM:
        raise InputError(f"seed must be from 0 to {GEOMETRY_STREAM - 1}, got {seed}")
    if not hours >= SHORTEST_H:
        raise InputError(f"hours must be at least {SHORTEST_H:.3g}, two periods of the error terms, got {hours:g}")
    if hours > LONGEST_H:
        raise InputError(f"hours must be at most {LONGEST_H:g}, since a run is held in memory, got {hours:g}")


@contextmanager
def _new_folder(out: Path, replace: bool) -> Iterator[Path]:
    """Give a folder beside `out` that takes its place at the end; on any problem it goes and `out` stays."""
    if out.exists() and not out.is_dir():
        raise InputError(f"'{out}' must be a folder, got a file; choose another --out")
    used = out.is_dir() and any(out.iterdir())
    if used and not replace:
        raise InputError(f"folder '{out}' must be empty; choose another --out or give --force to replace it")
    if used and not (out / "dataset.toml").is_file():
        raise InputError(f"folder '{out}' must hold a data set to be replaced, got none; choose another --out")
    beside = out.resolve().parent
    partial, old = (beside / f".{out.resolve().name}.{os.getpid()}.{what}" for what in ("partial", "old"))
    try:
        partial.mkdir(parents=True)
    except OSError as problem:
        raise InputError(f"folder '{out}' cannot be made: {problem.strerror}") from None
    try:
        yield partial
        if used:
            out.rename(old)
        partial.replace(out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)
