"""What a lost sensor costs when the decoder was trained to expect it, in closed form.

    python bench/sensor_dropout.py DATASET ...

The estimate that replaces a lost sensor is linear in the other sensors, and so are its modes. So copies of the training
data in which each sensor in turn is replaced need no rows: they are sums of the same normal equations, turned. A share
of the copies from 0 (as `thermotrue train` does) upwards; the linear decoder, every run or phase in turn left out.

The last row leaves the training alone and estimates the lost sensor's modes from those of the other sensors and of the
channels, instead of its temperature from the temperatures of the moment.
"""

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.linalg import cho_factor, cho_solve

from model.progress import track
from model.sensors import SensorModel
from model.transforms import Array
from training.dataset import load_dataset
from training.folds import folds
from training.sensor_sets import Fold, Inputs, SetJudge
from training.split import Split
from training.tip import tip_metric
from training.trainer import Settings

SHARES = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5)


def replacements(inputs: Inputs, split: Split) -> list[Array]:
    """Return, for each sensor, the matrix (F + 1, F + 1) that puts its estimate into the features."""
    dataset, prior = inputs.dataset, inputs.settings.prior
    model = SensorModel.fit(np.concatenate([inputs.readings[name] for name in split.train_runs]))
    width, features = len(prior.time_constants_s) + 1, inputs.samples.features.shape[1]
    size = np.array([prior.instant, *((np.array(prior.time_constants_s) / 3600.0) ** prior.tau_exponent)])
    found = []
    count = len(dataset.sensors)
    for sensor in range(count):
        # The estimate's dependence on each of the others, and its value when they are at the reference temperature.
        probe = np.full((count + 1, count), dataset.machine.reference_temperature_degC)
        probe[1:] += np.eye(count)
        probe[:, sensor] = np.nan
        said = model.fill(probe)[:, sensor]
        turned = np.eye(features)
        mine = slice(sensor * width, (sensor + 1) * width)
        turned[mine, mine] = 0.0
        for other in range(count):
            if other != sensor:
                theirs = slice(other * width, (other + 1) * width)
                turned[theirs, mine] = (said[1 + other] - said[0]) * np.eye(width)
        # A constant part: of changes since the run's start it is gone.
        turned[-1, mine] = size * (said[0] - dataset.machine.reference_temperature_degC) / inputs.swing_K
        found.append(turned)
    return found


def estimates(inputs: Inputs, fold: Fold) -> list[Array]:
    """Return the same with each sensor's modes by ridge regression on all other features of the training part."""
    width = len(inputs.settings.prior.time_constants_s) + 1
    square = fold.parts[0].square
    found = []
    for sensor in range(len(inputs.dataset.sensors)):
        mine = np.arange(sensor * width, (sensor + 1) * width)
        others = np.setdiff1d(np.arange(len(square)), mine)
        normal = square[np.ix_(others, others)] + inputs.settings.ridge * np.eye(len(others))
        turned = np.eye(len(square))
        turned[np.ix_(mine, mine)] = 0.0
        turned[np.ix_(others, mine)] = np.linalg.solve(normal, square[np.ix_(others, mine)])
        found.append(turned)
    return found


def fitted(inputs: Inputs, fold: Fold, turns: list[Array], share: float) -> Array:
    """Return the decoder's effect on what is judged (F + 1, G), with a share of the training data turned."""
    columns, mix = inputs.chosen(
        list(range(len(inputs.dataset.sensors))), list(range(len(inputs.dataset.channels))), fold.scale
    )
    weights = np.zeros((len(columns), inputs.basis.shape[1]))
    each = share / len(turns)
    for part in fold.parts:
        square = (1.0 - share) * part.square + each * sum(t.T @ part.square @ t for t in turns)
        product = (1.0 - share) * part.product + each * sum(t.T @ part.product for t in turns)
        normal = mix.T @ square @ mix + inputs.settings.ridge * np.eye(len(columns))
        weights[:, part.columns] = mix @ cho_solve(cho_factor(normal), mix.T @ product)
    effect: Array = weights @ inputs.basis.T
    return effect


def main() -> None:
    """Print a table for each data set."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="+", type=Path)
    for path in parser.parse_args().datasets:
        dataset = load_dataset(path)
        metric = tip_metric(dataset)
        inputs, splits = Inputs(dataset, metric, Settings()), folds(dataset)
        judge = SetJudge(inputs, splits)
        turns = [replacements(inputs, split) for split in splits]
        table = Table(title=f"{path.name}: {judge.drift_um:.2f} µm without compensation", title_justify="left")
        for column in ("share", "all sensors [µm]", "worst lost [µm]", "factor", "mean factor", "beside none"):
            table.add_column(column, justify="right")
        modes = [estimates(inputs, fold) for fold in judge.folds]
        ways = [*((f"{share:.0%}", share, turns) for share in SHARES), ("0%, by modes", 0.0, modes)]
        for name, share, replaced in track(ways, "fitting"):
            squares: list[list[Array]] = [[] for _ in range(len(dataset.sensors) + 1)]
            for fold, copies, mine in zip(judge.folds, turns, replaced, strict=True):
                effect = fitted(inputs, fold, copies, share)
                for kept, turned in zip(squares, [np.eye(len(effect)), *mine], strict=True):
                    kept.append(metric.mean_square(fold.truth - fold.features @ turned @ effect))
            whole, *lost = (float(np.sqrt(np.concatenate(kept).mean())) for kept in squares)
            worst = int(np.argmax(lost))
            table.add_row(
                name,
                f"{whole:.2f}",
                f"{lost[worst]:.2f} {dataset.sensors[worst]}",
                f"{lost[worst] / whole:.2f}",
                f"{np.mean(lost) / whole:.2f}",
                f"{lost[worst] / judge.drift_um:.2f}",
            )
        Console(width=110).print(table)


if __name__ == "__main__":
    main()
