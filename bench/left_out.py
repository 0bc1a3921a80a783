"""What the network and the baselines leave of the tip's drift on data they have not seen.

    python bench/left_out.py DATASET ...

Leaves out each duty cycle of a data set of several runs in turn (the part of the run's name behind the first `_`),
or each spindle phase of a single run, trains on the rest, and prints the pooled share of the tip's drift that is
left: root mean square over the working volume, divided by that without compensation. The baselines choose their
settings by leaving out parts of the training part, and so does the network; it is also tried without its nonlinear
residual, which folds of the training part keep or drop. Takes most of a minute for each that is left out.
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
from training.baselines.everyone import BASELINES
from training.choice import choose
from training.dataset import DataSet, MeasuredRun, load_dataset
from training.evaluation import NETWORK, NO_COMPENSATION, Method, compare, scored_rows
from training.fitted import fit_baselines
from training.split import Split, split_by_run
from training.tip import TipMetric, tip_metric
from training.tip_methods import measured_as
from training.trainer import Settings, Training, Verdict, train_network

LINEAR = "network, linear decoder"


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


def network(training: Training, dataset: DataSet, sensors: SensorModel, metric: TipMetric) -> Method:
    """Return the method that runs the torch network over a run."""

    def predict(run: MeasuredRun) -> Array:
        net: ThermalNetwork = training.net
        inputs = np.concatenate([sensors.fill(run.telemetry.temperatures), run.telemetry.channels], axis=1)
        dt_s = np.diff(run.telemetry.time_s, prepend=run.telemetry.time_s[0])
        with torch.no_grad():
            coefficients = net.decode(net.sequence(torch.tensor(inputs[None]), torch.tensor(dt_s[None])))[0].numpy()
        if dataset.datum == "run-start":
            coefficients = coefficients - coefficients[0]
        return measured_as(dataset, metric, training.fields, run, run.between(coefficients))

    return predict


def methods(dataset: DataSet, split: Split, metric: TipMetric) -> tuple[dict[str, Method], bool]:
    """Return baselines and networks trained on one split, and whether the network kept its residual."""
    found = {n: b.predict for n, b in fit_baselines(dataset, split, metric, Settings().degree).items()}
    sensors = SensorModel.fit(np.concatenate([dataset.runs[n].telemetry.temperatures for n in split.train_runs]))
    settings = choose(dataset, split, metric, sensors, Settings()).settings
    whole = train_network(dataset, split, metric, sensors, settings)
    linear = train_network(dataset, split, metric, sensors, settings, Verdict(False, 0.0, 0.0))
    found[LINEAR] = network(linear, dataset, sensors, metric)
    found[NETWORK] = network(whole, dataset, sensors, metric)
    return found, whole.verdict.keep


def left_out(path: Path) -> Table:
    """Return the table of one data set."""
    dataset = load_dataset(path)
    metric = tip_metric(dataset)
    names = [baseline.name for baseline in BASELINES]
    table = Table(title=f"{path.name}: share of the tip's drift left, each in turn left out", title_justify="left")
    for column in ("left out", *names, LINEAR, NETWORK, "residual kept"):
        table.add_column(column, justify="left" if column == "left out" else "right")
    squares: dict[str, float] = {}
    for name, split in splits(dataset):
        found, kept = methods(dataset, split, metric)
        masks = scored_rows(dataset, split.test, metric).masks
        scores = compare(dataset, split.test, found, metric)
        count = sum(int(mask.sum()) for mask in masks.values())
        for method, score in scores.items():
            squares[method] = squares.get(method, 0.0) + count * score.rms_um**2
        table.add_row(name, *(f"{scores[m].share:.1%}" for m in found), "yes" if kept else "no")
    shares = {method: float(np.sqrt(square / squares[NO_COMPENSATION])) for method, square in squares.items()}
    table.add_section()
    table.add_row("all together", *(f"{shares[m]:.1%}" for m in (*names, LINEAR, NETWORK)), "")
    best = min(names, key=lambda n: shares[n])
    table.caption = (
        f"the network leaves {shares[NETWORK] / shares[best]:.2f} times what the best baseline leaves ({best}), "
        f"{shares[NETWORK] / shares[names[0]]:.2f} times what {names[0]} leaves"
    )
    return table


def main() -> None:
    """Print a table for each data set."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="+", type=Path)
    torch.set_num_threads(1)
    for path in parser.parse_args().datasets:
        Console(width=130).print(left_out(path))


if __name__ == "__main__":
    main()
