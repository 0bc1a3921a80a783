"""From what a data set is made, and each of its runs, which depends on nothing else."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace

import numpy as np

from data_synth import climates, cycles
from data_synth.faults import Request
from data_synth.fields import Terms
from data_synth.geometric import Row, geometry
from data_synth.network import Array
from data_synth.probe import TOUCH_STREAM, TOUCHES, Touches, probe
from data_synth.run import (
    HELD_S,
    MOST_ROWS,
    PERIOD_S,
    TERMS_PERIOD_S,
    Run,
    Shop,
    check_period,
    run_kind,
    run_name,
    simulate,
)
from data_synth.summary import RunSummary
from data_synth.tip import tip_deviation
from model.error_map import ErrorMap
from model.exceptions import InputError
from model.machine import Machine

GEOMETRY_STREAM = 2**32 - 1
"""Beside the seed, where a run has its number."""


_NONE: Array = np.zeros(0)


@dataclass(frozen=True)
class Recipe:
    """What a data set is made from, beside its machine.

    Attributes
    ----------
    cycles : in which order its runs take them, from the first again after the last
    period_s : of the telemetry
    climate : name of the hall for all runs, or None for each cycle's own
    tool_tip : whether a touch probe measures on the way
    """

    runs: int
    hours: float
    seed: int
    cycles: tuple[str, ...]
    period_s: float = PERIOD_S
    climate: str | None = None
    faults: Request | None = None
    tool_tip: bool = False

    @property
    def terms_period_s(self) -> float:
        """Period of the error terms: the first sample of the telemetry after five minutes or more."""
        return self.period_s * int(np.ceil(TERMS_PERIOD_S / self.period_s))

    def kind(self, i: int) -> str:
        """Return the duty cycle of a run."""
        return run_kind(i, self.cycles)

    def name(self, i: int) -> str:
        """Return the name of a run."""
        return run_name(i, self.cycles)

    def check(self, machine: Machine) -> None:
        """Check that the machine can make it.

        Raises
        ------
        InputError
            with one sentence that says what cannot be.
        """
        if self.runs < 1:
            raise InputError(f"runs must be at least 1, got {self.runs}")
        if not 0 <= self.seed < GEOMETRY_STREAM:
            raise InputError(f"seed must be from 0 to {GEOMETRY_STREAM - 1}, got {self.seed}")
        check_period(self.period_s)  # before anything is divided by it
        shortest = 2 * self.terms_period_s / 3600.0
        if not self.hours >= shortest:
            raise InputError(
                f"hours must be at least {shortest:.3g}, two periods of the error terms, got {self.hours:g}"
            )
        longest = MOST_ROWS * min(self.period_s, HELD_S) / 3600.0
        if self.hours > longest:
            raise InputError(
                f"hours must be at most {longest:g} at a period of {self.period_s:g} s, since a run is held in memory, "
                f"got {self.hours:g}"
            )
        if not self.cycles:
            raise InputError("cycles must name at least one duty cycle, got none")
        for cycle in self.cycles:
            cycles.check(cycle, machine.axis_names)
        if self.climate is not None:
            climates.find(self.climate)

    def options(self, machine: Machine) -> str:
        """Return it as options of `thermotrue synth`, without those that have their usual value for this machine."""
        said = [f"--runs {self.runs} --hours {self.hours:g} --seed {self.seed}"]
        if self.cycles != cycles.order(machine):
            said.append(f"--cycles {','.join(self.cycles)}")
        if self.climate is not None:
            said.append(f"--climate {self.climate}")
        if self.period_s != PERIOD_S:
            said.append(f"--period {self.period_s:g}")
        if self.faults is not None:
            said.append(f"--faults {self.faults.text}")
        if self.tool_tip:
            said.append("--tool-tip")
        return " ".join(said)

    @property
    def machine_hours(self) -> float:
        """How long all runs take together."""
        return self.runs * self.hours

    def rows(self, shop: Shop) -> dict[str, int]:
        """Return how many rows each table has, those of faults aside, whose number is drawn."""
        held = round(self.hours * 3600.0 / HELD_S)
        samples = held * max(1, round(HELD_S / self.period_s)) // max(1, round(self.period_s / HELD_S))
        times = samples // round(self.terms_period_s / self.period_s) + 1
        terms = shop.machine.terms
        columns = sum(1 if t.kind == "location" else len(shop.fields.positions[t.axis]) for t in terms)
        rows = {"telemetry": self.runs * (samples + 1), "error_terms": self.runs * times * columns}
        return rows | ({"tool_tip": self.runs * times * TOUCHES} if self.tool_tip else {})

    def cold(self, shop: Shop) -> tuple[Row, ...]:
        """Return the cold errors of the machine, the same in all runs."""
        name = zlib.crc32(shop.machine.name.encode())  # another machine, or a sibling, was built by other hands
        rng = np.random.default_rng((self.seed, GEOMETRY_STREAM, name))
        return geometry(shop.machine, rng, shop.design.workmanship)


@dataclass(frozen=True)
class Made:
    """One run, ready to be written.

    Attributes
    ----------
    run : without the temperatures of the nodes
    peak : the error terms at the moment of the largest drift, less those at the start, one sample
    touches : what the probe measured, where one was asked for
    """

    run: Run
    summary: RunSummary
    peak: Terms
    touches: Touches | None

    def without_series(self) -> Made:
        """Return it without what has a row for each time, so that it can be kept."""
        run = replace(self.run, sensors={}, channels={}, time_s=_NONE, terms_time_s=_NONE, terms=self.peak)
        return replace(self, run=run, touches=None)


@dataclass(frozen=True)
class Maker:
    """Makes the runs of a recipe on a machine; small enough to be sent to another process."""

    shop: Shop
    recipe: Recipe

    def __call__(self, i: int) -> Made:
        """Return run number `i`, a function of machine, recipe and number alone."""
        shop, recipe, seed = self.shop, self.recipe, (self.recipe.seed, i)
        climate = None if recipe.climate is None else climates.find(recipe.climate)
        periods = (recipe.period_s, recipe.terms_period_s)
        run = simulate(shop, recipe.name(i), recipe.kind(i), seed, recipe.hours, *periods, climate, recipe.faults)
        summary = RunSummary.of(run, tip_deviation(shop.machine, run.terms))
        touches = None
        if recipe.tool_tip:
            cold = ErrorMap.from_rows(shop.machine, ((r.term, r.position, r.value) for r in recipe.cold(shop)))
            rng = np.random.default_rng((*seed, TOUCH_STREAM))
            touches = probe(shop.machine, run.terms_time_s, run.terms, cold, rng)
        at = int(np.searchsorted(run.terms_time_s, summary.furthest_s))
        return Made(replace(run, nodes_degC=run.nodes_degC[:0]), summary, _since_start(run.terms, at), touches)


def _since_start(terms: Terms, at: int) -> Terms:
    motion = {axis: values[at : at + 1] - values[:1] for axis, values in terms.motion.items()}
    location = {body: values[at : at + 1] - values[:1] for body, values in terms.location.items()}
    return Terms(terms.positions, motion, location)
