"""What a training costs: time and memory of the standard set, time against the size of the data, and of one step.

    python bench/training_cost.py

Makes the standard synthetic set (`bench/standard_set.py`), trains it with plain `thermotrue train --test-runs ...` in a
process of its own, and fits the network, nonlinear residual included, to 12, 24 and 48 runs. A step of the exported
network is timed in onnxruntime alone, as the service calls it. Figures are of this computer; prints them beside the
bars and exits with 1 where one is missed. Takes some minutes.
"""

import resource
import statistics
import subprocess
import sys
import tempfile
import time
from itertools import cycle, islice
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from rich.console import Console
from rich.table import Table
from standard_set import HOURS, SEEN, TEST, TRAIN, made

from data_synth.dataset import make_dataset
from data_synth.machines import open_shop
from model.bundle import Bundle, load_bundle
from model.sensors import SensorModel
from training.dataset import DataSet, load_dataset
from training.split import split_by_run
from training.tip import tip_metric
from training.trainer import Settings, Verdict, train_network

SIZES = (12, 24, 48)
REPEATS, STEPS = 3, 3000
MOST_S, MOST_MB, MOST_STEP_US = 300.0, 2048.0, 100.0
MOST_GROWTH = 1.25
"""Time of one run's data, in the largest set beside the smallest: 1 is linear; the rest is for caches and noise."""


def train(dataset: Path, out: Path, test_runs: list[str]) -> tuple[float, float]:
    """Train with plain defaults in a process of its own; return wall time [s] and peak memory [MB]."""
    command = [str(Path(sys.executable).with_name("thermotrue")), "train", str(dataset), "--out", str(out)]
    begin = time.monotonic()
    subprocess.run([*command, "--test-runs", ",".join(test_runs)], check=True, capture_output=True)
    seconds = time.monotonic() - begin
    return seconds, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0


def fit_s(dataset: DataSet, count: int) -> float:
    """Return the time of one fit to the first runs, the least of some [s]."""
    names = list(dataset.runs)
    split, metric = split_by_run(dataset, names[count:]), tip_metric(dataset)
    sensors = SensorModel.fit(np.concatenate([dataset.runs[n].telemetry.temperatures for n in split.train_runs]))
    found = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        train_network(dataset, split, metric, sensors, Settings(), Verdict(True, 1.0, 1.0))
        found.append(time.perf_counter() - begin)
    return min(found)


def step_us(bundle: Bundle) -> float:
    """Return the median time of one step in onnxruntime [µs]."""
    assert bundle.network is not None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(bundle.network, options, providers=["CPUExecutionProvider"])
    fed = {i.name: np.full((1, i.shape[1]), 20.0) for i in session.get_inputs()}
    fed["fresh"][:] = 0.0
    found = []
    for _ in range(STEPS):
        begin = time.perf_counter()
        session.run(None, fed)
        found.append(time.perf_counter() - begin)
    return 1e6 * statistics.median(found)


def main() -> None:
    """Print the table."""
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        test_runs = list(made(folder / "standard", 1, 0).runs)[TRAIN : TRAIN + TEST]
        seconds, megabytes = train(folder / "standard", folder / "bundle", test_runs)
        step = step_us(load_bundle(folder / "bundle"))
        order = [*islice(cycle(SEEN), SIZES[-1] + 1)]
        make_dataset(open_shop("vmc3"), len(order), HOURS, 2, folder / "large", order=order, pictures=False)
        large = load_dataset(folder / "large")
        fits = {count: fit_s(large, count) for count in SIZES}
    growth = (fits[SIZES[-1]] / SIZES[-1]) / (fits[SIZES[0]] / SIZES[0])
    table = Table(title="what a training costs", title_justify="left")
    for column, side in (("", "left"), ("measured", "right"), ("bar", "right"), ("", "left")):
        table.add_column(column, justify=side)  # type: ignore[arg-type]
    rows = [
        ("training the standard set, wall time", seconds, MOST_S, "s", 1),
        ("its peak memory", megabytes, MOST_MB, "MB", 0),
        *((f"one fit to {count} runs", fit, np.inf, "s", 2) for count, fit in fits.items()),
        (f"time of a run's data, {SIZES[-1]} runs beside {SIZES[0]}", growth, MOST_GROWTH, "", 2),
        ("one step in onnxruntime, median", step, MOST_STEP_US, "µs", 1),
    ]
    for what, value, bar, unit, digits in rows:
        limit, verdict = ("", "") if bar == np.inf else (f"{bar:g} {unit}", "met" if value <= bar else "missed")
        table.add_row(what, f"{value:.{digits}f} {unit}", limit, verdict)
    Console(width=100).print(table)
    sys.exit(0 if all(row[1] <= row[2] for row in rows) else 1)


if __name__ == "__main__":
    main()
