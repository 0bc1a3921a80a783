"""What a network leaves that was trained on tool-tip deviations alone, beside one trained on the error terms.

    python bench/tool_tip.py [--machine vmc3] [--runs 24] [--hours 12] [--seed 0]

Makes a synthetic data set with both tables, in which a touch probe measures at four positions of the working volume,
drawn anew every five minutes, with noise. Leaves out each third of the runs in turn, trains on the same runs from
either table or from both, and judges all by the true error terms: root mean square of the tip's residual over the
working volume, pooled, without anything of what was left out. The bar is 1.5 times the residual of the terms.
"""

import argparse
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from data_synth.dataset import make_dataset
from data_synth.machines import open_shop
from model.sensors import SensorModel
from model.tables import read_table, write_table
from model.transforms import Array
from training.choice import choose
from training.dataset import DataSet, MeasuredRun, load_dataset
from training.evaluation import column_basis
from training.split import Split
from training.tip import tip_metric
from training.trainer import Settings, Training, train_network

PARTS = 3
TERMS, TIP = "error_terms", "tool_tip"


@dataclass(frozen=True)
class Way:
    """One way to have measured the same runs.

    Attributes
    ----------
    tables : which of the tables it has
    hourly : whether only one position an hour is left of the tip's
    half : whether every other run has only terms, and those between only the tip
    """

    name: str
    tables: tuple[str, ...]
    hourly: bool = False
    half: bool = False


WAYS = (
    Way("error terms", (TERMS,)),
    Way("tool tip, four positions every five minutes", (TIP,)),
    Way("tool tip, one position every hour", (TIP,), hourly=True),
    Way("terms of every other run, tip of the others", (TERMS, TIP), half=True),
)


def as_measured(source: Path, out: Path, way: Way) -> DataSet:
    """Copy the data set as it would be, had it been measured this way."""
    shutil.copytree(source, out, ignore=shutil.ignore_patterns(f"{TERMS}.*", f"{TIP}.*", "*.png"))
    for name in way.tables:
        table = read_table(source / f"{name}.parquet", text=("run", "term"))
        keep = np.ones(len(table), dtype=bool)
        if way.half:
            odd = np.array([int(run[1:].split("_")[0]) % 2 for run in table.text["run"]], dtype=bool)
            keep &= odd == (name == TIP)
        if way.hourly:
            time_s = table.numbers["time_s"]
            keep &= (time_s % 3600.0 == 0.0) & np.append(True, np.diff(time_s) != 0.0)
        text = {column: cells[keep].tolist() for column, cells in table.text.items()}
        write_table(out / f"{name}.parquet", text | {column: cells[keep] for column, cells in table.numbers.items()})
    return load_dataset(out)


def predicted(training: Training, dataset: DataSet, run: MeasuredRun, sensors: SensorModel) -> Array:
    """Return the coefficients of the fields at the times of measurement, shape (N, P)."""
    inputs = np.concatenate([sensors.fill(run.telemetry.temperatures), run.telemetry.channels], axis=1)
    dt_s = np.diff(run.telemetry.time_s, prepend=run.telemetry.time_s[0])
    with torch.no_grad():
        net = training.net
        coefficients = net.decode(net.sequence(torch.tensor(inputs[None]), torch.tensor(dt_s[None])))[0].numpy()
    return run.between(coefficients - coefficients[0] if dataset.datum == "run-start" else coefficients)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", default="vmc3")
    parser.add_argument("--runs", type=int, default=24)
    parser.add_argument("--hours", type=float, default=12.0)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    with TemporaryDirectory() as folder:
        source = Path(folder) / "data"
        shop = open_shop(arguments.machine)
        make_dataset(shop, arguments.runs, arguments.hours, arguments.seed, source, tool_tip=True)
        sets = [as_measured(source, Path(folder) / str(i), way) for i, way in enumerate(WAYS)]
    truth = sets[0]
    metric = tip_metric(truth)
    names = list(truth.runs)
    squares, drift, took = np.zeros(len(WAYS)), 0.0, np.zeros(len(WAYS))
    count = 0
    for part in range(PARTS):
        out = names[part::PARTS]
        drift += sum(metric.mean_square(metric.sample(truth.runs[name].values)).sum() for name in out)
        count += sum(len(truth.runs[name].time_s) for name in out)
        for i, dataset in enumerate(sets):
            start = time.perf_counter()
            split = left_out(dataset, out)
            sensors = SensorModel.fit(
                np.concatenate([dataset.runs[name].telemetry.temperatures for name in split.train_runs])
            )
            settings = choose(dataset, split, tip_metric(dataset), sensors, Settings()).settings
            training = train_network(dataset, split, tip_metric(dataset), sensors, settings)
            took[i] += time.perf_counter() - start
            basis = column_basis(training.fields, truth.columns)
            for name in out:
                run = truth.runs[name]
                said = metric.sample(predicted(training, dataset, run, sensors) @ basis.T)
                squares[i] += metric.mean_square(metric.sample(run.values) - said).sum()
    title = f"{arguments.machine}, {arguments.runs} runs of {arguments.hours:g} h, each third of them left out in turn"
    table = Table("trained on", "left [µm]", "share of the drift", "beside terms", "seconds", title=title)
    for way, square, seconds in zip(WAYS, squares, took, strict=True):
        row = (
            f"{np.sqrt(square / count):.2f}",
            f"{np.sqrt(square / drift):.1%}",
            f"{np.sqrt(square / squares[0]):.2f}",
        )
        table.add_row(way.name, *row, f"{seconds / PARTS:.1f}")
    Console(width=110).print(table)


def left_out(dataset: DataSet, out: list[str]) -> Split:
    """Return the split that leaves out these runs."""
    train = {name: np.full(len(run.time_s), name not in out) for name, run in dataset.runs.items()}
    return Split(train, {name: ~mask for name, mask in train.items()}, "a third")


if __name__ == "__main__":
    main()
