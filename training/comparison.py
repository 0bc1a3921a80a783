"""The network of a bundle beside the baselines, on the same measurements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from model.exceptions import DataError
from model.predictor import Predictor
from training.dataset import load_dataset
from training.evaluation import NETWORK, compare
from training.fitted import fit_baselines
from training.job import Result
from training.joined import joined
from training.split import Split
from training.tip import tip_metric
from training.tip_methods import judged_network


@dataclass(frozen=True)
class Comparison:
    """The network and the baselines side by side.

    Attributes
    ----------
    result : of the network, with the baselines among its methods and scores
    settings : of each baseline
    trained_on : runs that the baselines were trained on
    """

    result: Result
    settings: dict[str, Mapping[str, Any]]
    trained_on: list[str]

    @property
    def ratio(self) -> float:
        """What the network leaves of the tip's drift, divided by what the best baseline leaves."""
        scores = self.result.scores
        return scores[NETWORK].rms_um / min(scores[name].rms_um for name in self.settings)

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        baselines = {"trained_on": self.trained_on, "settings": {n: dict(s) for n, s in self.settings.items()}}
        return {**self.result.as_dict(), "baselines": baselines, "network_by_best_baseline": self.ratio}

    def summary(self) -> str:
        """Return two sentences on how to read the table."""
        best = min(self.settings, key=lambda name: self.result.scores[name].rms_um)
        network = self.result.bundle.manifest.training.get("runs", [])
        return (
            f"the network leaves {self.ratio:.2f} times what the best baseline leaves ({best}); the baselines were "
            f"trained on {len(self.trained_on)} runs ({', '.join(self.trained_on)}), the network on {len(network)}"
        )


def with_baselines(result: Result, train_on: Path | None) -> Comparison:
    """Train the baselines and score them on the measurements that the network was scored on.

    They are trained on the runs of another data set, or on those that are not tested.

    Raises
    ------
    DataError
        where that leaves none, or the other data set does not fit.
    """
    torch.set_num_threads(1)  # the tensors are small; threads would wait for each other
    dataset, other = result.dataset, None if train_on is None else load_dataset(train_on)
    if other is not None and other.fingerprint != dataset.fingerprint:
        dataset = joined(dataset, other)
        names = [name for name in dataset.runs if name not in result.dataset.runs]
    else:
        names = [name for name in dataset.runs if name not in result.test_runs]
    if not names:
        raise DataError(
            f"baselines must have runs to train on, got all {len(dataset.runs)} of '{dataset.path}' to test on; "
            "name some to test on (--runs), or other data to train on (--train-on)"
        )
    train = {name: np.full(len(run.time_s), name in names) for name, run in dataset.runs.items()}
    split = Split(train, {name: ~mask for name, mask in train.items()}, result.left_out)
    metric = result.metric if dataset is result.dataset else tip_metric(dataset)
    predictor = Predictor(result.bundle)
    trained = fit_baselines(dataset, split, metric, predictor.fields.degree)
    methods = {name: one.predict for name, one in trained.items()}
    methods[NETWORK] = judged_network(predictor, dataset, metric)
    scores = compare(dataset, result.tested, methods, metric)
    return Comparison(
        replace(result, dataset=dataset, metric=metric, methods=methods, scores=scores),
        {name: one.settings for name, one in trained.items()},
        names,
    )
