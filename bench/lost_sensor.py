"""What is left of the tip's drift when one sensor at a time is lost.

    python bench/lost_sensor.py DATASET ... [--share 0.25] [--seed 0]

Trains as `thermotrue train` without the last quarter of the runs (of a single run, its last phase) and runs the bundle
over these as the service does, with one sensor at a time replaced by its estimate from the others: for the whole run,
and from a third of the run on. Prints the residual beside that with all sensors, over all left-out runs and in the run
in which it grows most. Ends with exit code 1 if a sensor more than doubles it over all of them, or if any run is left
worse than without compensation.
"""

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from model.progress import track
from training.dataset import DataSet, MeasuredRun, load_dataset
from training.evaluation import NETWORK, NO_COMPENSATION, Score, compare
from training.job import Result, train_bundle

MOST = 2.0
"""Largest factor by which a lost sensor may raise what is left."""


def without(run: MeasuredRun, sensor: int, start: float) -> MeasuredRun:
    """Return the run with a sensor that gives no reading from a share of the run on."""
    temperatures = run.telemetry.temperatures.copy()
    temperatures[int(start * len(temperatures)) :, sensor] = np.nan
    return replace(run, telemetry=replace(run.telemetry, temperatures=temperatures))


def lost(result: Result, dataset: DataSet, sensor: int, start: float) -> Score:
    """Return what the network leaves on the left-out runs with a sensor lost."""
    method = result.methods[NETWORK]
    methods = {"lost": lambda run: method(without(run, sensor, start))}
    return compare(dataset, result.tested, methods, result.metric)["lost"]


def judge(path: Path, share: float, seed: int) -> bool:
    """Print the table of a data set, and return whether all sensors may be lost."""
    dataset = load_dataset(path)
    names = list(dataset.runs)
    # A single run is divided as `thermotrue train` does by default: its last spindle phase is left out.
    test_runs = names[len(names) - max(1, round(share * len(names))) :] if len(names) > 1 else None
    with tempfile.TemporaryDirectory() as folder:
        result = train_bundle(path, Path(folder) / "bundle", test_runs, seed)
        whole = result.scores[NETWORK]
        nothing = result.scores[NO_COMPENSATION]
        table = Table(
            title=f"{result.machine}, left out: {result.left_out}; no compensation {nothing.rms_um:.2f} µm, "
            f"all sensors {whole.rms_um:.2f} µm ({whole.share:.1%})",
            title_justify="left",
        )
        table.add_column("lost sensor")
        for column in ("whole run [µm]", "factor", "most in a run", "from a third on [µm]", "factor", "beside none"):
            table.add_column(column, justify="right")
        passed = True
        for number, name in enumerate(track(dataset.sensors, "losing sensors")):
            always, later = lost(result, dataset, number, 0.0), lost(result, dataset, number, 1.0 / 3.0)
            by_run = {run: um / whole.by_run_um[run] for run, um in always.by_run_um.items()}
            worst = max(by_run, key=lambda run: by_run[run])
            beside = max(
                score.by_run_um[run] / nothing.by_run_um[run] for score in (always, later) for run in score.by_run_um
            )
            factors = [score.rms_um / whole.rms_um for score in (always, later)]
            passed = passed and max(factors) <= MOST and beside <= 1.0
            table.add_row(
                name,
                f"{always.rms_um:.2f}",
                f"{factors[0]:.2f}",
                f"{by_run[worst]:.2f} in {worst}",
                f"{later.rms_um:.2f}",
                f"{factors[1]:.2f}",
                f"{beside:.2f}",
            )
    Console(width=120).print(table)
    print("beside none: the most that is left in a run, as a share of that without compensation; at most 1")
    return passed


def main() -> None:
    """Print a table for each data set."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="+", type=Path)
    parser.add_argument("--share", type=float, default=0.25, help="Of the runs that are left out, from the end.")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    passed = [judge(path, options.share, options.seed) for path in options.datasets]
    sys.exit(0 if all(passed) else 1)


if __name__ == "__main__":
    main()
