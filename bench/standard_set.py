"""The standard synthetic set of `vmc3`: 24 training runs, 12 test runs with duty cycles that are not in training.

    python bench/standard_set.py [--seeds 1,2,3] [--limit]

Makes the runs, trains the network and the baselines on the 24, and prints the share of the tip's drift that they leave
of the 12. With `--limit` it also prints what the linear decoder leaves of the same 12 runs when it has seen eight times
as many training runs, and when it has seen as many of the test runs' own duty cycles: what no training on 24 others can
be expected to beat.
"""

import argparse
import tempfile
from itertools import cycle, islice
from pathlib import Path

import numpy as np
import torch
from left_out import LINEAR, methods, network
from rich.console import Console
from rich.table import Table

from data_synth.dataset import make_dataset
from data_synth.machines import open_shop
from model.sensors import SensorModel
from training.baselines.everyone import BASELINES
from training.choice import choose
from training.dataset import DataSet, load_dataset
from training.evaluation import NETWORK, compare
from training.split import Split
from training.tip import tip_metric
from training.trainer import Settings, Verdict, train_network

SEEN = ("shop", "steps", "spectrum", "axes", "warmup", "restart", "night", "constant")
UNSEEN = ("spindle", "etve", "coolant", "doors", "breaks", "heating")
HOURS, TRAIN, TEST = 12.0, 24, 12
MORE = 168
"""Further training runs for the limit: with the 24, eight times as many."""


def made(folder: Path, seed: int, more: int) -> DataSet:
    """Return the standard set and behind it `more` runs of the seen and `TRAIN + more` of the unseen duty cycles."""
    order = [*islice(cycle(SEEN), TRAIN), *islice(cycle(UNSEEN), TEST)]
    if more:
        order += [*islice(cycle(SEEN), more), *islice(cycle(UNSEEN), TRAIN + more)]
    make_dataset(open_shop("vmc3"), len(order), HOURS, seed, folder, order=order, pictures=False)
    return load_dataset(folder)


def divided(dataset: DataSet, train: range | list[int]) -> Split:
    """Return the split that trains on these runs and tests on the 12."""
    masks = {name: np.ones(len(run.time_s), dtype=bool) for name, run in dataset.runs.items()}
    names = list(dataset.runs)
    tested = names[TRAIN : TRAIN + TEST]
    trained = [names[i] for i in train]
    return Split({n: masks[n] for n in trained}, {n: masks[n] for n in tested}, "runs of other duty cycles")


def linear_share(dataset: DataSet, split: Split) -> float:
    """Return the share of the drift that the linear decoder leaves."""
    metric = tip_metric(dataset)
    sensors = SensorModel.fit(np.concatenate([dataset.runs[n].telemetry.temperatures for n in split.train_runs]))
    settings = choose(dataset, split, metric, sensors, Settings()).settings
    training = train_network(dataset, split, metric, sensors, settings, Verdict(False, 0.0, 0.0))
    found = {LINEAR: network(training, dataset, sensors, metric)}
    return compare(dataset, split.test, found, metric)[LINEAR].share


def standard(seeds: list[int]) -> Table:
    """Return the table of network and baselines."""
    names = [baseline.name for baseline in BASELINES]
    table = Table(title="vmc3: share of the tip's drift left of 12 runs of duty cycles not in training")
    for column in ("seed", *names, LINEAR, NETWORK, "network / best baseline"):
        table.add_column(column, justify="right")
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            dataset = made(Path(folder) / "set", seed, 0)
            metric = tip_metric(dataset)
            split = divided(dataset, range(TRAIN))
            scores = compare(dataset, split.test, methods(dataset, split, metric)[0], metric)
        best = min(scores[n].share for n in names)
        shares = [f"{scores[m].share:.1%}" for m in (*names, LINEAR, NETWORK)]
        table.add_row(str(seed), *shares, f"{scores[NETWORK].share / best:.2f}")
    return table


def limit(seeds: list[int]) -> Table:
    """Return the table of what more training runs would give."""
    table = Table(title="The linear decoder's share left of the same 12 runs, trained on")
    columns = ("24 runs", f"{TRAIN + MORE} runs of the same cycles", f"{TRAIN + MORE} runs of the test's own cycles")
    for column in ("seed", *columns):
        table.add_column(column, justify="right")
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            dataset = made(Path(folder) / "set", seed, MORE)
            first, second = TRAIN + TEST, TRAIN + TEST + MORE
            few, more = range(TRAIN), [*range(TRAIN), *range(first, second)]
            own = range(second, second + TRAIN + MORE)
            table.add_row(str(seed), *(f"{linear_share(dataset, divided(dataset, t)):.1%}" for t in (few, more, own)))
    return table


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="1,2,3")
    parser.add_argument("--limit", action="store_true", help="also what more training runs would give")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    seeds = [int(seed) for seed in arguments.seeds.split(",")]
    Console(width=130).print(standard(seeds))
    if arguments.limit:
        Console(width=130).print(limit(seeds))


if __name__ == "__main__":
    main()
