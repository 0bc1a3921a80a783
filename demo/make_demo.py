"""Make the demo machine's bundle, its hour of telemetry and the README's picture again, from seeds and code.

`make bundle` runs it; it takes about a minute and writes the same each time: data byte for byte,
the network to the rounding of the processor and its number of threads.
"""

import csv
import shutil
from pathlib import Path

from data_synth.dataset import make_dataset
from data_synth.machines import open_shop
from training.job import Result, train_bundle
from training.tables import print_scores

ROOT = Path(__file__).parent.parent
RUNS, HOURS, SEED = 24, 12.0, 1


def main() -> None:
    """Make data, train, draw, and cut out an hour of warming up."""
    dataset = ROOT / "out" / "vmc3"
    dataset.parent.mkdir(exist_ok=True)
    shop = open_shop("vmc3")
    shutil.rmtree(dataset, ignore_errors=True)
    make_dataset(shop, RUNS, HOURS, SEED, dataset)
    result = train_bundle(dataset, ROOT / "demo" / "vmc3", None, seed=0)
    print_scores(result.scores, f"vmc3, left out: {result.left_out}")
    print(result.summary())
    result.draw(ROOT / "docs" / "test-day.png")
    _write_warm_up(result)


def _write_warm_up(result: Result) -> None:
    """Write the first hour of the run that drifts furthest in it."""
    dataset, metric = result.dataset, result.metric
    drift = {}
    for name, measured in dataset.runs.items():
        hour = measured.values[measured.time_s <= 3600.0]
        drift[name] = float(metric.mean_square(metric.sample(hour - hour[0]))[-1])
    run = dataset.runs[max(drift, key=lambda name: drift[name])].telemetry
    with (ROOT / "demo" / "warm_up.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["time_s", *dataset.sensors, *dataset.channels])
        for i in range(61):
            cells = [*run.temperatures[i], *run.channels[i]]
            writer.writerow([f"{run.time_s[i]:g}", *(f"{c:.6g}" for c in cells)])


if __name__ == "__main__":
    main()
