"""What the network and ridge regression leave of the tip's drift on data they have not seen.

    python bench/left_out.py DATASET ...

Leaves out each duty cycle of a data set of several runs in turn (the part of the run's name behind the first `_`),
or each spindle phase of a single run, trains on the rest, and prints the pooled share of the tip's drift that is
left: root mean square over the working volume, divided by that without compensation. Also without the nonlinear
residual, which folds of the training part keep or drop.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from model.network import ThermalNetwork
from model.sensors import SensorModel
from model.transforms import Array
from training.baselines import fit_ridge
from training.dataset import DataSet, MeasuredRun, load_dataset
from training.evaluation import column_basis
from training.split import Split, split_by_run
from training.tip import TipMetric, tip_metric
from training.trainer import Settings, Training, Verdict, train_network


def splits(dataset: DataSet) -> list[tuple[str, Split]]:
    """Return what is left out in turn, by name."""
    names = list(dataset.runs)
    if len(names) > 1:
        kinds = list(dict.fromkeys(name.split("_", 1)[-1] for name in names))
        return [(kind, split_by_run(dataset, [n for n in names if n.split("_", 1)[-1] == kind])) for kind in kinds]
    run = dataset.runs[names[0]]
    speed = run.telemetry.channels[:, dataset.channels.index("spindle_rpm")]
    edges = run.telemetry.time_s[np.flatnonzero(np.diff(speed)) + 1]
    phase = np.searchsorted(edges, run.time_s, side="right")
    found = []
    for k in range(phase.max() + 1):
        out = phase == k
        if np.ptp(run.time_s[out]) > 1800.0:  # the minutes before the first start are not a phase
            rpm = speed[np.searchsorted(run.telemetry.time_s, run.time_s[out][0])]
            found.append((f"{k}: {rpm:g} rpm", Split({names[0]: ~out}, {names[0]: out}, f"phase {k}")))
    return found


def network(training: Training, dataset: DataSet, run: MeasuredRun, sensors: SensorModel, metric: TipMetric) -> Array:
    """Return the terms on the metric's grid as the torch network predicts them."""
    net: ThermalNetwork = training.net
    inputs = np.concatenate([sensors.fill(run.telemetry.temperatures), run.telemetry.channels], axis=1)
    dt_s = np.diff(run.telemetry.time_s, prepend=run.telemetry.time_s[0])
    with torch.no_grad():
        coefficients = net.decode(net.sequence(torch.tensor(inputs[None]), torch.tensor(dt_s[None])))[0].numpy()
    if dataset.datum == "run-start":
        coefficients = coefficients - coefficients[0]
    columns = run.between(coefficients) @ column_basis(training.fields, dataset.columns).T
    return metric.sample(np.where(np.isfinite(run.values), columns, np.nan))


def main() -> None:
    """Print a table for each data set."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="+", type=Path)
    torch.set_num_threads(1)
    for path in parser.parse_args().datasets:
        dataset = load_dataset(path)
        metric = tip_metric(dataset)
        columns = ("ridge regression", "network, linear decoder", "network")
        table = Table(title=f"{path.name}: share of the tip's drift left, each in turn left out", title_justify="left")
        for column in ("left out", *columns, "residual kept"):
            table.add_column(column)
        squares = np.zeros(len(columns) + 1)
        for name, split in splits(dataset):
            sensors = SensorModel.fit(
                np.concatenate([dataset.runs[n].telemetry.temperatures for n in split.train_runs])
            )
            ridge = fit_ridge(dataset, split, metric, sensors)
            settings = Settings()
            whole = train_network(dataset, split, metric, sensors, settings)
            linear = train_network(dataset, split, metric, sensors, settings, Verdict(False, 0.0, 0.0))
            mine = np.zeros_like(squares)
            for run_name in split.test_runs:
                run, out = dataset.runs[run_name], split.test[run_name]
                truth = metric.sample(run.values)
                for i, predicted in enumerate(
                    (
                        np.zeros_like(truth),
                        ridge.predict(run),
                        network(linear, dataset, run, sensors, metric),
                        network(whole, dataset, run, sensors, metric),
                    )
                ):
                    mine[i] += metric.mean_square((truth - predicted)[out]).sum()
            squares += mine
            shares = np.sqrt(mine[1:] / mine[0])
            table.add_row(name, *(f"{s:.1%}" for s in shares), "yes" if whole.verdict.keep else "no")
        shares = np.sqrt(squares[1:] / squares[0])
        table.add_section()
        table.add_row("all together", *(f"{s:.1%}" for s in shares), f"{shares[-1] / shares[0]:.2f} of ridge")
        Console(width=110).print(table)


if __name__ == "__main__":
    main()
