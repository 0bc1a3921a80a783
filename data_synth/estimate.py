"""How large a data set will be, and how long it takes: from one of its runs, made for a try."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from data_synth.recipe import Maker, Recipe
from data_synth.run import HELD_S, Shop
from data_synth.workers import cores
from data_synth.writer import DataSetWriter, Format

TRIED_H = 12.0
ALONE = 60_000
"""Samples below which one process has done before others have started (chosen): a second or two of work."""
START_S, PICTURES_S = 1.5, 2.0  # as measured on two cores


@dataclass(frozen=True)
class Estimate:
    """What a data set takes.

    Attributes
    ----------
    rows : of each table
    size : in bytes
    seconds : with that many workers
    """

    rows: dict[str, int]
    size: int
    seconds: float
    workers: int


def usual_workers(recipe: Recipe) -> int:
    """Return how many processes a data set gets unless told otherwise: all cores, or one for a small one."""
    samples = recipe.machine_hours * 3600.0 / min(recipe.period_s, HELD_S)
    return min(cores(), recipe.runs) if samples > ALONE else 1


def estimate(shop: Shop, recipe: Recipe, form: Format, workers: int, pictures: bool = True) -> Estimate:
    """Return what the data set would take here, as the first hours of its first run do, written and thrown away."""
    shortest = 2 * recipe.terms_period_s / 3600.0
    tried = replace(recipe, runs=1, hours=min(recipe.hours, max(TRIED_H, shortest)))
    share = recipe.machine_hours / tried.machine_hours
    with TemporaryDirectory() as folder, DataSetWriter(Path(folder), shop.machine, (), form) as writer:
        make = Maker(shop, tried)
        writer.write((one := make(0)).run, one.touches)  # what is loaded and cached is not timed
        start = time.perf_counter()
        one = make(0)
        made = time.perf_counter()
        writer.write(one.run, one.touches)
        written = time.perf_counter()
        writer.close()
        size = sum(file.stat().st_size for file in Path(folder).glob(f"*.{form}")) / 2.0
    making, writing = share * (made - start), share * (written - made)
    # This process writes while the others make.
    seconds = making + writing if workers == 1 else START_S + max(writing, (making + writing) / min(workers, cores()))
    return Estimate(recipe.rows(shop), round(size * share), seconds + PICTURES_S * pictures, workers)
