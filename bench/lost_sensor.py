"""What is left of the tip's drift when sensors are lost, and whether the bundle knows it.

    python bench/lost_sensor.py DATASET ... [--share 0.25] [--seed 0] [--sets 6]

Trains as `thermotrue train` without the last quarter of the runs (of a single run, its last phase) and runs the bundle
over these as the service does, with one sensor at a time lost: for the whole run, and from a third of the run on; then
with random sets of two, of three and of a third of the sensors. Prints what is left beside that with all sensors, over
all left-out runs and in the run in which it grows most; the share of the tip's deviations within the 95 % interval; the
mean reliability that the bundle states, and beside it what it would have been by what is really left: the share of the
drift's mean square that the loss did not cost. Ends with exit code 1 if one lost sensor more than doubles what is left,
over all left-out runs or in any one, or if any run is left worse than without compensation.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from model.predictor import Predictor, ThermalState
from model.progress import track
from model.transforms import Array
from training.dataset import DataSet, MeasuredRun, load_dataset
from training.evaluation import NETWORK, NO_COMPENSATION, Score, chosen_inputs, compare
from training.interval import Interval, interval
from training.job import Result, train_bundle
from training.tip_methods import measured_as

MOST = 2.0
"""Largest factor by which a lost sensor may raise what is left."""
EVERY = 10
"""Samples of which one is asked for its reliability."""


@dataclass(frozen=True)
class Told:
    """What is left on the left-out runs with some sensors lost, and what the bundle says of it."""

    score: Score
    interval: Interval | None
    reliability: float


def without(run: MeasuredRun, sensors: Sequence[int], start: float) -> MeasuredRun:
    """Return the run with sensors that give no reading from a share of the run on."""
    temperatures = run.telemetry.temperatures.copy()
    temperatures[int(start * len(temperatures)) :, list(sensors)] = np.nan
    return replace(run, telemetry=replace(run.telemetry, temperatures=temperatures))


def lost(result: Result, predictor: Predictor, dataset: DataSet, sensors: Sequence[int], start: float) -> Told:
    """Return what the network leaves on the left-out runs with sensors lost."""
    states: dict[str, list[ThermalState]] = {}
    metric = result.metric

    def method(run: MeasuredRun) -> Array:
        name = run.telemetry.name
        if name not in states:
            states[name] = predictor.states(chosen_inputs(predictor, dataset, without(run, sensors, start)))
        found = np.array([s.coefficients for s in states[name]])
        found = found - found[0] if predictor.datum == "run-start" else found
        return measured_as(dataset, metric, predictor.fields, run, run.between(found))

    score = compare(dataset, result.tested, {"lost": method}, metric)["lost"]
    did = None
    if predictor.uncertainty is not None:
        spread = {name: predictor.spread(found) for name, found in states.items()}
        did = interval(
            dataset,
            result.tested,
            method,
            lambda run: run.between(spread[run.telemetry.name]),
            predictor.uncertainty,
            metric,
        )
    missed = [predictor.missed(state) for found in states.values() for state in found[::EVERY]]
    return Told(score, did, float(np.mean([m.reliability for m in missed if m is not None])))


def row(name: str, told: Told, later: Told | None, whole: Score, nothing: Score) -> tuple[list[str], float, float]:
    """Return a row of the table, the largest factor, and the largest share of no compensation."""
    both = [told] if later is None else [told, later]
    by_run = {run: um / whole.by_run_um[run] for run, um in told.score.by_run_um.items()}
    worst = max(by_run, key=lambda run: by_run[run])
    beside = max(t.score.by_run_um[run] / nothing.by_run_um[run] for t in both for run in by_run)
    factors = [t.score.rms_um / whole.rms_um for t in both]
    runs = max(um / whole.by_run_um[run] for t in both for run, um in t.score.by_run_um.items())
    earned = 1.0 - (told.score.rms_um**2 - whole.rms_um**2) / nothing.rms_um**2
    cells = [
        name,
        f"{told.score.rms_um:.2f}",
        f"{factors[0]:.2f}",
        f"{by_run[worst]:.2f} in {worst}",
        "" if later is None else f"{factors[1]:.2f}",
        f"{beside:.2f}",
        "" if told.interval is None else f"{told.interval.within:.1%}",
        f"{told.reliability:.3f} ({min(earned, 1.0):.3f})",
    ]
    return cells, max(*factors, runs), beside


def judge(path: Path, share: float, seed: int, sets: int) -> bool:
    """Print the table of a data set, and return whether any one sensor may be lost."""
    dataset = load_dataset(path)
    names = list(dataset.runs)
    # A single run is divided as `thermotrue train` does by default: its last spindle phase is left out.
    test_runs = names[len(names) - max(1, round(share * len(names))) :] if len(names) > 1 else None
    with tempfile.TemporaryDirectory() as folder:
        result = train_bundle(path, Path(folder) / "bundle", test_runs, seed)
    # The bundle of a single run has seen everything; the network without the left-out phase is the one to judge.
    predictor = Predictor(result.bundle) if result.making is None else result.making.predictor
    whole, nothing = result.scores[NETWORK], result.scores[NO_COMPENSATION]
    known = lost(result, predictor, dataset, [], 0.0)
    table = Table(
        title=f"{result.machine}, left out: {result.left_out}; no compensation {nothing.rms_um:.2f} µm, "
        f"all sensors {whole.rms_um:.2f} µm ({whole.share:.1%})",
        title_justify="left",
    )
    table.add_column("lost")
    columns = ("whole run [µm]", "factor", "most in a run", "from a third on", "beside none", "within 95 %")
    for column in (*columns, "reliability (earned)"):
        table.add_column(column, justify="right")
    table.add_row(*row("nothing", known, None, whole, nothing)[0])
    table.add_section()
    passed = True
    for number, name in enumerate(track(dataset.sensors, "losing sensors")):
        always, later = (lost(result, predictor, dataset, [number], start) for start in (0.0, 1.0 / 3.0))
        cells, factor, beside = row(name, always, later, whole, nothing)
        passed = passed and factor <= MOST and beside <= 1.0
        table.add_row(*cells)
    table.add_section()
    rng = np.random.default_rng(seed)
    count = len(dataset.sensors)
    for together in sorted({2, 3, max(count // 3, 2)} if sets else set()):
        for _ in track(range(sets), f"losing {together} at a time"):
            some = sorted(rng.choice(count, min(together, count), replace=False).tolist())
            told = lost(result, predictor, dataset, some, 0.0)
            table.add_row(*row(" ".join(dataset.sensors[i] for i in some), told, None, whole, nothing)[0])
    Console(width=140).print(table)
    print("beside none: the most that is left in a run, as a share of that without compensation; at most 1")
    return passed


def main() -> None:
    """Print a table for each data set."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="+", type=Path)
    parser.add_argument("--share", type=float, default=0.25, help="Of the runs that are left out, from the end.")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sets", type=int, default=6, help="Random sets of each size that are lost together.")
    options = parser.parse_args()
    passed = [judge(path, options.share, options.seed, options.sets) for path in options.datasets]
    sys.exit(0 if all(passed) else 1)


if __name__ == "__main__":
    main()
