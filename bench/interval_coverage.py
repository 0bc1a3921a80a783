"""How often the tip lies within the 95 % interval of the prediction, on data that the network has not seen.

    python bench/interval_coverage.py DATASET ...

Leaves out each duty cycle of a data set of several runs in turn (the part of the run's name behind the first `_`), or
of names without one each of N groups of runs, or each spindle phase of a single run. The network has its linear
decoder alone, and the interval comes from parts of the training part that it leaves out itself. Printed are the share
of the tip's deviations in x, y and z, over the working volume and the times of measurement, that lie within the
interval, and how wide it is, as the mean of what it allows to either side. A few seconds for each that is left out.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from left_out import network, splits
from rich.console import Console
from rich.table import Table

from model.sensors import SensorModel
from model.transforms import Array
from model.uncertainty import Uncertainty
from training.choice import choose
from training.dataset import DataSet, MeasuredRun, load_dataset
from training.evaluation import Method
from training.interval import Spread, interval, pooled
from training.split import Split
from training.tip import TipMetric, tip_metric
from training.trainer import Settings, train_network
from training.uncertainty import estimate, scaled_modes


def trained(dataset: DataSet, split: Split, metric: TipMetric) -> tuple[Method, Spread, Uncertainty, int]:
    """Return the network, how far it may be off at a run's times of measurement, and parts that told so."""
    sensors = SensorModel.fit(np.concatenate([dataset.runs[n].telemetry.temperatures for n in split.train_runs]))
    # Without steps, the nonlinear residual does not help and is not kept.
    s = choose(dataset, split, metric, sensors, Settings(steps=0)).settings
    found = train_network(dataset, split, metric, sensors, s)
    parts = (found.net, found.fields, sensors, found.solve)
    record = estimate(dataset, split, metric, *parts, ridge=s.ridge, correlation_s=s.correlation_s)
    if record is None:
        raise SystemExit(f"{dataset.path} is too little to be divided")
    uncertainty = Uncertainty(found.fields, record, found.net.modes)

    def spread(run: MeasuredRun) -> Array:
        inputs = np.concatenate([sensors.fill(run.telemetry.temperatures), run.telemetry.channels], axis=1)
        dt_s = np.diff(run.telemetry.time_s, prepend=run.telemetry.time_s[0])
        with torch.no_grad():
            features = found.net.sequence(torch.tensor(inputs[None]), torch.tensor(dt_s[None]))[0].numpy()
        z = scaled_modes(found.net, features)
        return run.between(uncertainty.size_of(z - z[0] if dataset.datum == "run-start" else z))

    return network(found, dataset, sensors, metric), spread, uncertainty, record.parts


def coverage(path: Path) -> Table:
    """Return the table of one data set."""
    dataset = load_dataset(path)
    metric = tip_metric(dataset)
    table = Table(title=f"{path.name}: within the 95 % interval, each in turn left out", title_justify="left")
    for column in ("left out", "parts to learn from", "within", "± [µm]"):
        table.add_column(column, justify="left" if column == "left out" else "right")
    found = []
    for name, split in splits(dataset):
        method, spread, uncertainty, parts = trained(dataset, split, metric)
        one = interval(dataset, split.test, method, spread, uncertainty, metric)
        found.append(one)
        table.add_row(name, str(parts), f"{one.within:.1%}", f"{one.half_width_um:.1f}")
    table.add_section()
    whole = pooled(found)
    table.add_row("all together", "", f"{whole.within:.1%}", f"{whole.half_width_um:.1f}")
    return table


def main() -> None:
    """Print a table for each data set."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="+", type=Path)
    torch.set_num_threads(1)
    for path in parser.parse_args().datasets:
        Console(width=100).print(coverage(path))


if __name__ == "__main__":
    main()
