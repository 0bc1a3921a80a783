"""A simulated week of a machine tool with every sensor fault, played into the service.

    python bench/fault_week.py [--bundle demo/vmc3] [--seeds 1001 1002] [--each-sensor]

The week is one of two shifts in a hall of its own climate, a sample a minute. It is played into the service's own
machine state, as telemetry would be, with its guard, weights and rate limit, and what it serves is compared with the
true deviation every five minutes at 27 positions: once healthy, once with each kind of fault as `thermotrue synth
--faults` makes them, and once with all. `--each-sensor` adds the worst that each fault can do: every sensor in turn,
for as long as that fault lasts at most. Two zeros are tried: the absolute one, and a datum set when the week begins.

Prints the residual with compensation beside that without, over the whole week and while a sensor was faulty. Ends with
exit code 1 where the 99th percentile with compensation is more than 1.1 times that without.
"""

from __future__ import annotations

import argparse
import itertools
import logging
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from data_synth.faults import KINDS, Fault, Request, apply
from data_synth.faults import plan as plan_faults
from data_synth.machines import open_shop
from data_synth.run import Run, simulate
from model.bundle import Bundle, load_bundle
from model.chain import Chain
from model.progress import track
from model.terms import UM
from model.transforms import Array
from service.machine_state import MachineState
from service.schemas import Sample
from service.settings import Settings

Flags = NDArray[np.bool_]

MOST = 1.1
"""Largest 99th percentile of what is left, as a multiple of that without compensation."""
BEGIN_S = 1.8e9
"""When the week begins on the machine's clock: any time will do."""
CLASSES = ("none", *KINDS, "all")
LONGEST_H = {"dropout": 24.0, "stuck": 24.0, "offset": 24.0, "swapped": math.inf}
"""How long a fault of one sensor lasts where it is to do its worst."""


@dataclass(frozen=True)
class Week:
    """A week without faults, and the true deviation that belongs to it.

    Attributes
    ----------
    run : what the machine did
    truth_um : shape (u, n, 3), at the times of the run's error terms and n positions
    """

    bundle: Bundle
    run: Run
    truth_um: Array

    @classmethod
    def simulated(cls, bundle: Bundle, seed: int, hours: float, kind: str = "shifts") -> Week:
        """Return a week of the bundle's machine; the thermometers are those it was trained with."""
        shop = open_shop(bundle.machine.name)
        run = simulate(shop, f"week {seed}", kind, (int(bundle.manifest.training.get("seed", 1)), seed), hours)
        week = cls(bundle, run, np.empty(0))
        heads, values = run.terms.columns(shop.machine)
        e = np.empty((len(run.terms_time_s), len(week.positions), len(shop.machine.terms)))
        for k, term in enumerate(shop.machine.terms):
            columns = [c for c, (name, _) in enumerate(heads) if name == term.name]
            if term.kind == "location":
                e[:, :, k] = values[:, columns] * term.to_internal
                continue
            knots = np.array([heads[c][1] for c in columns], dtype=float)
            at = week.positions[:, shop.machine.axis_names.index(term.axis)]
            e[:, :, k] = [np.interp(at, knots, row) for row in values[:, columns] * term.to_internal]
        return replace(week, truth_um=week.tip_um(e))

    @cached_property
    def positions(self) -> Array:
        """Return 27 positions over the working volume, shape (n, A) [mm]."""
        axes = [self.bundle.machine.axes[a] for a in self.bundle.machine.axis_names]
        return np.array([*itertools.product(*(np.linspace(axis.low, axis.high, 3) for axis in axes))])

    @cached_property
    def _sensitivity(self) -> Array:
        return np.asarray(Chain(self.bundle.machine).sensitivity(self.positions)[:, :3], dtype=float)

    def tip_um(self, e: Array) -> Array:
        """Return what error terms (..., n, K) do to the tip, shape (..., n, 3) [µm]."""
        moved: Array = np.einsum("nik,...nk->...ni", self._sensitivity, e) / UM
        return moved

    def played(self, faults: Sequence[Fault], settings: Settings, *, datum: bool) -> Played:
        """Play it into the service's machine state with these faults, and return what was left."""
        run = self.run
        now = [BEGIN_S]
        machine = MachineState(self.bundle, settings, lambda: now[0], lambda: now[0])
        assert machine.thermal is not None
        shown = apply(run.sensors, run.time_s, faults)
        served = np.empty((len(run.terms_time_s), len(self.positions), len(self.bundle.machine.terms)))
        weight = np.empty(len(run.terms_time_s))
        replaced = np.zeros((len(run.time_s), len(shown)), dtype=bool)
        geometry = self.bundle.geometry.evaluate(self.positions)
        looks = {float(t): i for i, t in enumerate(run.terms_time_s)}
        for j, time_s in enumerate(run.time_s):
            now[0] = BEGIN_S + float(time_s)
            readings = {name: None if np.isnan(v[j]) else float(v[j]) for name, v in shown.items()}
            channels = {name: float(v[j]) for name, v in run.channels.items()}
            machine.take([Sample(time=now[0], temperatures=readings, channels=channels)])
            replaced[j] = [name in machine.thermal.faults for name in shown]
            if datum and j == 0:
                machine.thermal.set_datum()
            if (i := looks.get(float(time_s))) is not None:
                outlook, handed = machine.hand_out(None, now[0])
                served[i], weight[i] = handed.errors.evaluate(self.positions) - geometry, outlook.target.weight
        truth = self.truth_um - self.truth_um[0] if datum else self.truth_um
        faulty = {name: np.zeros(len(run.time_s), dtype=bool) for name in shown}
        for fault in faults:
            faulty[fault.sensor] |= fault.cells(run.time_s)
        cells = np.array([*faulty.values()]).T
        hit = np.interp(run.terms_time_s, run.time_s, cells.any(axis=1).astype(float)) > 0.0
        return Played(truth, truth - self.tip_um(served), hit, weight, cells, replaced)


@dataclass(frozen=True)
class Played:
    """A week as served.

    Attributes
    ----------
    without_um, left_um : deviation without compensation and with it, shape (u, n, 3)
    hit : whether a sensor was faulty then, shape (u,)
    weight : how much of the thermal part counted, shape (u,)
    faulty, replaced : per sample and sensor, shape (t, S)
    """

    without_um: Array
    left_um: Array
    hit: Flags
    weight: Array
    faulty: Flags
    replaced: Flags

    def figures(self, during: bool = False) -> tuple[float, float, float, float]:
        """Return rms and 99th percentile, without and with compensation [µm]; nan where no sensor was faulty."""
        rows = self.hit if during else np.ones(len(self.hit), dtype=bool)
        if not rows.any():
            return (math.nan,) * 4
        sizes = [np.linalg.norm(d[rows], axis=-1) for d in (self.without_um, self.left_um)]
        rms, most = ([float(f(s)) for s in sizes] for f in (_rms, lambda s: np.percentile(s, 99)))
        return rms[0], most[0], rms[1], most[1]

    @property
    def ratio(self) -> float:
        """The larger of the two ratios of 99th percentiles, of the whole week and of its faulty times."""
        found = [f[3] / f[1] for f in (self.figures(), self.figures(during=True))]
        return float(np.nanmax(found))

    @property
    def missed(self) -> tuple[float, float]:
        """Shares of faulty readings that were believed, and of healthy ones that were not."""
        healthy = ~self.faulty
        return (
            float((self.faulty & ~self.replaced).sum() / max(self.faulty.sum(), 1)),
            float((healthy & self.replaced).sum() / healthy.sum()),
        )


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def planned(week: Week, kind: str, seed: int) -> tuple[Fault, ...]:
    """Return faults of one kind, or of all, as often as a data set has them."""
    if kind == "none":
        return ()
    rates = {k: h.per_100h for k, h in KINDS.items() if kind in (k, "all")}
    rng = np.random.default_rng((seed, CLASSES.index(kind)))
    return plan_faults(week.run.name, tuple(week.run.sensors), week.run.time_s, Request(rates), rng)


def worst(week: Week, kind: str, sensor: str) -> Iterator[tuple[Fault, ...]]:
    """Yield what one fault of a sensor can do at its worst, begun on Tuesday's early shift or from the start."""
    time_s, name = week.run.time_s, week.run.name
    begin = float(time_s[min(26 * 60, len(time_s) // 4)])
    if kind == "spike":
        each = range(5, len(time_s) - 5, 10)
        sizes = itertools.cycle((5.0, -5.0, 20.0, 100.0))
        moments = [float(time_s[j]) for j in each]
        yield tuple(Fault(name, sensor, kind, t, t, s) for t, s in zip(moments, sizes, strict=False))
        return
    end = min(begin + 3600.0 * LONGEST_H[kind], float(time_s[-1]))
    if kind == "swapped":
        others = [s for s in week.run.sensors if s != sensor]
        apart = {s: float(np.abs(week.run.sensors[s] - week.run.sensors[sensor]).max()) for s in others}
        other = max(apart, key=lambda s: apart[s])
        for start in (begin, 0.0):
            yield tuple(Fault(name, a, kind, start, end, None, b) for a, b in ((sensor, other), (other, sensor)))
        return
    for size in (5.0, -5.0, 2.0) if kind == "offset" else (None,):
        yield (Fault(name, sensor, kind, begin, end, size),)


def print_table(title: str, rows: Sequence[tuple[str, Played]], console: Console) -> bool:
    """Print what was left with each fault, and return whether none did harm."""
    table = Table(title=title, title_justify="left")
    table.add_column("fault")
    columns = ("rms without", "with", "99 % without", "with", "ratio", "faulty: 99 % without", "with", "ratio")
    for column in (*columns, "believed", "false", "weight"):
        table.add_column(column, justify="right")
    for name, played in rows:
        whole, during = played.figures(), played.figures(during=True)
        cells = [whole[0], whole[2], whole[1], whole[3], whole[3] / whole[1], during[1], during[3]]
        text = ["-" if math.isnan(c) else f"{c:.2f}" for c in (*cells, during[3] / during[1])]
        table.add_row(name, *text, *(f"{s:.1%}" for s in played.missed), f"{played.weight.mean():.2f}")
    console.print(table)
    return all(played.ratio <= MOST for _, played in rows)


def main() -> None:
    """Play the weeks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bundle", type=Path, default=Path("demo/vmc3"))
    parser.add_argument("--seeds", type=int, nargs="+", default=[1001, 1002])
    parser.add_argument("--hours", type=float, default=168.0)
    parser.add_argument("--kinds", nargs="+", default=CLASSES, choices=CLASSES)
    parser.add_argument("--zeros", nargs="+", default=["absolute", "datum"], choices=["absolute", "datum"])
    parser.add_argument("--each-sensor", action="store_true")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    bundle = load_bundle(options.bundle)
    settings = Settings(replay=True)
    console = Console(width=150)
    passed = True
    for seed in options.seeds:
        week = Week.simulated(bundle, seed, options.hours)
        for datum in [z == "datum" for z in options.zeros]:
            zero = "datum set at its start" if datum else "absolute"
            title = f"{bundle.machine.name}, week {seed}, {zero} [µm]"
            rows = [(k, week.played(planned(week, k, seed), settings, datum=datum)) for k in track(options.kinds, zero)]
            passed = print_table(title, rows, console) and passed
            if options.each_sensor:
                found = {}
                cases = [(k, s) for k in KINDS if k in options.kinds for s in week.run.sensors]
                for kind, sensor in track(cases, f"{zero}, each sensor"):
                    each = [week.played(faults, settings, datum=datum) for faults in worst(week, kind, sensor)]
                    one = max(each, key=lambda p: p.ratio)
                    found[f"{kind} {sensor}"] = one
                passed = print_table(f"{title}, one sensor at its worst", [*found.items()], console) and passed
    print(f"ratio: of the 99th percentiles, at most {MOST:g}")
    print("believed: faulty readings that passed; false: healthy ones that did not")
    sys.exit(0 if passed else 1)


if __name__ == "__main__":
    main()
