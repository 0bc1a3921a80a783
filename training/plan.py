"""What a training would do, found out and checked before it is done."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from model.bundle import check_free
from training.baselines.everyone import BASELINES
from training.baselines.protocol import Baseline
from training.checkpoint import program
from training.dataset import DataSet, load_dataset, runs_named
from training.earlier import Earlier, load_earlier
from training.evaluation import NO_COMPENSATION, compare, scored_rows
from training.making import Stopwatch
from training.plausibility import check_plausible, notices
from training.split import Split, default_split, everything, split_by_run
from training.tip import TipMetric, tip_metric
from training.trained import Task
from training.trainer import Settings

FAST = BASELINES[:2]
"""Ridge regressions: they take a second and are mostly the best; the others take a minute or more."""


@dataclass(frozen=True)
class Plan:
    """What a training would do.

    Attributes
    ----------
    split : what is left out to measure the network
    again : whether the bundle's network is trained again on everything
    baselines : that it is measured beside
    drift_um : root mean square of the tip's deviation in the left-out measurements
    note : which of the left-out measurements are not scored, or how; empty where all are
    notices : what looks odd in the data, a sentence each
    """

    dataset: DataSet
    out: Path
    split: Split
    again: bool
    metric: TipMetric
    settings: Settings
    earlier: Earlier | None
    baselines: tuple[Baseline, ...]
    drift_um: float
    note: str
    notices: list[str]

    @property
    def measured(self) -> Task:
        """The network that is measured."""
        return Task(self.dataset, self.split, self.metric, self.settings, self.earlier)

    @property
    def served(self) -> Task:
        """The network in the bundle."""
        return Task(self.dataset, everything(self.dataset), self.metric, self.settings, self.earlier)

    @property
    def chooses(self) -> bool:
        """Whether the prior's sizes and the penalty are chosen; a network to start from has them already."""
        return self.earlier is None

    @property
    def stages(self) -> list[str]:
        """Names of what is kept in a checkpoint, in order."""
        again = ["network_of_everything"] if self.again else []
        return [
            *(["choice"] if self.chooses else []),
            "network",
            "bundle",
            *(stage_of(b) for b in self.baselines),
            "settling_time",
            *again,
        ]

    @property
    def made_of(self) -> dict[str, Any]:
        """All that the results depend on, for a checkpoint."""
        return {
            "data": self.dataset.fingerprint,
            "test runs": [self.again, self.split.test_runs],
            "settings": self.settings.as_dict(),
            "baselines": [b.name for b in self.baselines],
            "network to start from": None if self.earlier is None else self.earlier.origin,
            "program": program(),
        }

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        dataset = self.dataset
        return {
            "machine": dataset.machine.name,
            "dataset": str(dataset.path),
            "bundle": str(self.out),
            "runs": list(dataset.runs),
            "sensors": list(dataset.sensors),
            "channels": list(dataset.channels),
            "terms": list(dataset.terms),
            "terms_measured": list(dataset.measured_terms),
            "tip_measured": dataset.places > 0,
            "datum": dataset.datum,
            "samples": sum(len(run.telemetry.time_s) for run in dataset.runs.values()),
            "measurements": sum(len(run.time_s) for run in dataset.runs.values()),
            "hours": sum(float(np.ptp(run.telemetry.time_s)) for run in dataset.runs.values()) / 3600.0,
            "left_out": self.split.description,
            "test_runs": self.split.test_runs,
            "trained_again_on_everything": self.again,
            "baselines": [b.name for b in self.baselines],
            "drift_um": self.drift_um,
            "note": self.note,
            "notices": self.notices,
        }

    def sentences(self) -> list[str]:
        """Return it for people."""
        d = self.as_dict()
        what = [f"{len(d['terms_measured'])} of {len(self.dataset.machine.terms)} error terms"] * bool(
            d["terms_measured"]
        )
        what += ["the tool tip"] * d["tip_measured"]
        served = "then it is trained again on everything" if self.again else "it stays out of the bundle's network"
        return [
            f"{d['machine']}: {_count(d['runs'], 'run')} of {d['hours']:.1f} h in all, {d['samples']} samples of "
            f"{_count(d['sensors'], 'sensor')} and {_count(d['channels'], 'channel')}",
            f"measured: {' and '.join(what)}, at {d['measurements']} times; datum {d['datum']}",
            f"left out to measure the network: {d['left_out']}; {served}",
            f"the tip drifts by {self.drift_um:.1f} µm there (root mean square over the working volume)",
            f"beside it: {', '.join(d['baselines'])}",
            f"would write {d['bundle']}; nothing was trained or written",
        ]


def plan_training(
    path: Path,
    out: Path,
    test_runs: list[str] | None,
    seed: int,
    start: Path | None = None,
    baselines: tuple[Baseline, ...] = FAST,
    watch: Stopwatch | None = None,
) -> Plan:
    """Read and check all that a training needs; nothing is written.

    Raises
    ------
    InputError
        where something is wrong, in a sentence.
    """
    check_free(out)
    dataset = load_dataset(path)
    if watch is not None:
        watch.lap("reading the data set")
    split = (
        default_split(dataset, seed)
        if test_runs is None
        else split_by_run(dataset, runs_named(dataset, test_runs, "--test-runs"))
    )
    metric = tip_metric(dataset)
    check_plausible(dataset, metric)
    drift = compare(dataset, split.test, {}, metric)  # is there something to test on? Better known before training
    settings = Settings(seed=seed)
    earlier = None if start is None else load_earlier(start, dataset, settings.degree)
    if watch is not None:
        watch.lap("checking it")
    return Plan(
        dataset,
        out,
        split,
        test_runs is None,
        metric,
        settings,
        earlier,
        baselines,
        drift[NO_COMPENSATION].rms_um,
        scored_rows(dataset, split.test, metric).note,
        notices(dataset),
    )


def stage_of(baseline: Baseline) -> str:
    """Return the name of a baseline's stage."""
    return "baseline_" + "".join(c if c.isalnum() else "_" for c in baseline.name)


def _count(names: list[str], what: str) -> str:
    return f"{len(names)} {what}{'' if len(names) == 1 else 's'}"
