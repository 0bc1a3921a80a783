"""Make a whole data set: runs, cold errors, data card, pictures; the folder appears when all of it is there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

from data_synth import cycles
from data_synth.card import Picture, card
from data_synth.faults import Request
from data_synth.picture import draw
from data_synth.picture_terms import draw_angles, draw_location, draw_motion, motion_axes
from data_synth.picture_volume import draw_volume
from data_synth.recipe import Made, Maker, Recipe
from data_synth.run import PERIOD_S, Shop
from data_synth.summary import RunSummary
from data_synth.tip import tip_deviation
from data_synth.workers import in_order
from data_synth.writer import DataSetWriter, Format
from model.exceptions import InputError
from model.machine import Machine

Track = Callable[[Sequence[int]], Iterable[int]]
"""Wraps the numbers of the runs, to show progress."""


def make_dataset(
    shop: Shop,
    runs: int,
    hours: float,
    seed: int,
    out: Path,
    form: Format = "parquet",
    replace: bool = False,
    track: Track = iter,
    *,
    order: Sequence[str] | None = None,
    climate: str | None = None,
    period_s: float = PERIOD_S,
    faults: Request | None = None,
    tool_tip: bool = False,
    workers: int = 1,
    pictures: bool = True,
) -> list[RunSummary]:
    """Write a data set into the folder `out` and return a summary of each run; see `Recipe` and `write_dataset`.

    Parameters
    ----------
    order : duty cycles of the runs, by default the machine's order of a data set
    """
    taken = cycles.order(shop.machine) if order is None else tuple(order)
    recipe = Recipe(runs, hours, seed, taken, period_s, climate, faults, tool_tip)
    return write_dataset(shop, recipe, out, form, replace, track, workers, pictures)


def write_dataset(
    shop: Shop,
    recipe: Recipe,
    out: Path,
    form: Format = "parquet",
    replace: bool = False,
    track: Track = iter,
    workers: int = 1,
    pictures: bool = True,
) -> list[RunSummary]:
    """Write a data set into the folder `out` and return a summary of each run.

    Parameters
    ----------
    replace : whether a data set that is there already may go
    workers : number of processes; the bytes do not depend on it
    pictures : whether to draw; it takes two seconds, which a fleet of small data sets may do without

    Raises
    ------
    InputError
        where the folder is in use, or the recipe makes no data set.
    """
    recipe.check(shop.machine)
    if workers < 1:
        raise InputError(f"workers must be at least 1, got {workers}")
    summaries: list[RunSummary] = []
    with new_folder(out, replace) as folder:
        cold, first, furthest = recipe.cold(shop), None, None
        with (
            DataSetWriter(folder, shop.machine, cold, form) as writer,
            closing(in_order(Maker(shop, recipe), recipe.runs, workers)) as made,
        ):
            for _ in track(range(recipe.runs)):
                one = next(made)
                writer.write(one.run, one.touches)
                summaries.append(one.summary)
                first = first or one
                if furthest is None or one.summary.furthest_um > furthest.summary.furthest_um:
                    furthest = one.without_series()
        assert first is not None
        assert furthest is not None
        drawn = _draw(folder, shop.machine, first, furthest) if pictures else []
        text = card(shop, recipe, summaries, drawn, form)
        (folder / "README.md").write_text(text, encoding="utf-8", newline="\n")
    return summaries


def _draw(folder: Path, machine: Machine, first: Made, furthest: Made) -> list[Picture]:
    """Draw the first run, and the moment of the largest drift of all runs."""
    run, most = first.run, furthest.summary
    deviation = tip_deviation(machine, run.terms)
    middle = deviation[:, deviation.shape[1] // 2]
    pictures = [
        Picture("overview.png", f"Temperatures, spindle speed and drift of the tool tip in run {run.name}"),
        *(Picture(f"motion_{a.lower()}.png", f"Motion errors of {a} over its position") for a in motion_axes(machine)),
    ]
    draw(folder / "overview.png", machine.name, run, middle - middle[:1])
    series = (machine, run.name, run.terms_time_s, run.terms)
    for axis, picture in zip(motion_axes(machine), pictures[1:], strict=True):
        draw_motion(folder / picture.file, *series, axis)
    body = draw_location(folder / "location.png", *series)
    draw_angles(folder / "angles.png", *series)
    moment = f"run {most.name}, {most.furthest_s / 3600.0:.1f} h after power-on"
    title = f"{machine.name}: largest drift of the tool tip, {moment}"
    draw_volume(folder / "volume.png", machine, title, furthest.peak)
    return [
        *pictures,
        Picture("location.png", f"Location errors of {body}, the first axis on the bed, over time"),
        Picture("angles.png", "Angles between axes, and the shift of the tool holder, over time"),
        Picture("volume.png", f"Drift of the tool tip over the working volume where it is largest: {moment}"),
    ]


@contextmanager
def new_folder(out: Path, replace: bool) -> Iterator[Path]:
    """Give a folder beside `out` that takes its place at the end; on any problem it goes and `out` stays."""
    used = check_folder(out, replace)
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


def check_folder(out: Path, replace: bool) -> bool:
    """Return whether the folder holds a data set, which is to be replaced.

    Raises
    ------
    InputError
        where it is in use.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"'{out}' must be a folder, got a file; choose another --out")
    used = out.is_dir() and any(out.iterdir())
    if used and not replace:
        raise InputError(f"folder '{out}' must be empty; choose another --out or give --force to replace it")
    if used and not (out / "dataset.toml").is_file():
        raise InputError(f"folder '{out}' must hold a data set to be replaced, got none; choose another --out")
    return used
