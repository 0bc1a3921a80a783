"""What the demo's network leaves of the tip's drift when nobody sends it spindle speed, feeds and coolant.

    python bench/missing_channels.py [BUNDLE DATASET]

By default demo/vmc3 on out/vmc3, which `make bundle` leaves there: runs it was trained on, so the first row flatters;
what counts is the distance of the others from it. `held` stops hearing the channels a third into each run.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from model.bundle import load_bundle
from model.predictor import Predictor
from training.dataset import MeasuredRun, load_dataset
from training.evaluation import compare, network_method
from training.tip import tip_metric


def without(run: MeasuredRun, how: str) -> MeasuredRun:
    """Return the run with its channels as `how` says."""
    channels = run.telemetry.channels.copy()
    third = len(channels) // 3
    if how == "never given, taken as 0":
        channels[:] = 0.0
    elif how == "held at the value of a third of the run":
        channels[third:] = channels[third]
    elif how == "held for ten minutes, then 0":
        channels[third : third + 10] = channels[third]
        channels[third + 10 :] = 0.0
    return replace(run, telemetry=replace(run.telemetry, channels=channels))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundle", nargs="?", type=Path, default=Path("demo/vmc3"))
    parser.add_argument("dataset", nargs="?", type=Path, default=Path("out/vmc3"))
    arguments = parser.parse_args()
    dataset = load_dataset(arguments.dataset)
    predictor = Predictor(load_bundle(arguments.bundle))
    metric = tip_metric(dataset)
    method = network_method(predictor, dataset, metric)
    everything = {name: np.ones(len(run.time_s), dtype=bool) for name, run in dataset.runs.items()}
    table = Table("channels", "share left", "worst run [µm]")
    for how in (
        "all given",
        "never given, taken as 0",
        "held for ten minutes, then 0",
        "held at the value of a third of the run",
    ):
        scores = compare(dataset, everything, {how: lambda run, how=how: method(without(run, how))}, metric)
        by_run = scores[how].by_run_um
        worst = max(by_run, key=lambda name: by_run[name])
        table.add_row(how, f"{scores[how].share:.1%}", f"{worst} {by_run[worst]:.1f}")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
