"""A training job from data set to bundle, and the evaluation of a bundle."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from model.bundle import Bundle, load_bundle
from model.exceptions import DataError
from model.predictor import Predictor
from training.baselines.protocol import Baseline
from training.checkpoint import Checkpoint, Stored
from training.choice import Choice
from training.dataset import DataSet, load_dataset, runs_named
from training.evaluation import NETWORK, NO_COMPENSATION, Method, Score, compare, scored_rows
from training.fitted import Trained as FittedBaseline
from training.fitted import fit_baseline
from training.interval import Interval, network_interval
from training.making import Making, Stopwatch
from training.plan import FAST, plan_training, stage_of
from training.settling import settling_time_s
from training.split import Mask
from training.tip import TipMetric, tip_metric
from training.tip_methods import judged_network
from training.trained import Task, Trained
from training.trainer import Verdict


@dataclass(frozen=True)
class Result:
    """What a job found.

    Attributes
    ----------
    scores : residuals on the left-out measurements, by method
    left_out : which measurements those were
    tested : the same, run by run
    seen : of these, runs that the bundle was trained on
    note : which of the left-out measurements are not scored, or how; empty where all are
    making : how the bundle came about, where this job made it
    interval : how the network's 95 % interval did there; None where the bundle does not say how far it may be off
    notices : what looks odd in the data, a sentence each
    """

    machine: str
    bundle: Bundle
    dataset: DataSet
    metric: TipMetric
    methods: Mapping[str, Method]
    scores: Mapping[str, Score]
    left_out: str
    tested: Mapping[str, Mask]
    seen: list[str]
    note: str
    making: Making | None = None
    interval: Interval | None = None
    notices: list[str] = field(default_factory=list)

    @property
    def test_runs(self) -> list[str]:
        """Runs with measurements left out."""
        return [name for name, mask in self.tested.items() if mask.any()]

    def draw(self, path: Path) -> None:
        """Draw the test run that drifts most."""
        from training.picture import draw_test_run  # noqa: PLC0415 (matplotlib is slow to import)

        drift = self.scores[NO_COMPENSATION].by_run_um
        run = max(drift, key=lambda name: drift[name])
        draw_test_run(path, self.dataset, run, self.tested[run], self.methods, self.metric)

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {
            "machine": self.machine,
            "bundle": str(self.bundle.path),
            "version": self.bundle.version,
            "left_out": self.left_out,
            "test_runs": self.test_runs,
            "trained_on": self.seen,
            "note": self.note,
            "notices": self.notices,
            "scores": {name: score.as_dict() for name, score in self.scores.items()},
            **({} if self.interval is None else {"interval": self.interval.as_dict()}),
        }

    def summary(self) -> str:
        """Return one paragraph on the bundle."""
        trained = self.bundle.manifest.training["runs"]
        again = (
            f"the network in it was trained again on everything ({len(trained)} runs), the left-out part included; "
            "--test-runs keeps runs out of it"
            if self.seen
            else f"trained on {len(trained)} runs, without the ones left out"
        )
        return f"bundle {self.bundle.path} (version {self.bundle.version}): {again}"


def train_bundle(
    path: Path,
    out: Path,
    test_runs: list[str] | None,
    seed: int,
    start: Path | None = None,
    checkpoint: Checkpoint | None = None,
    baselines: tuple[Baseline, ...] = FAST,
) -> Result:
    """Train, measure on left-out data and write a bundle.

    With `test_runs` named, these stay out of the bundle's network. Without, the default split measures the network,
    and the bundle's network is trained again on everything: a customer's few runs are too dear to leave out.
    `start` is a bundle whose network to start from. `checkpoint` keeps what is done, so that the same call goes on
    after a kill; who made it removes it.

    Raises
    ------
    InputError
        for wrong data, before anything is written.
    """
    torch.set_num_threads(1)  # the tensors are small; threads would wait for each other
    watch = Stopwatch()
    plan = plan_training(path, out, test_runs, seed, start, baselines, watch)
    checkpoint = Checkpoint(None) if checkpoint is None else checkpoint
    checkpoint.begin(plan.made_of, plan.stages)
    for notice in plan.notices:
        print(f"note: {notice}", file=sys.stderr)
    dataset, split, metric = plan.dataset, plan.split, plan.metric
    choice = Choice(plan.settings)
    if plan.chooses:
        choice = checkpoint.stage("choice", plan.measured.chosen, Choice.stored, Choice.restored)
        watch.count("choosing the prior", checkpoint.seconds["choice"])
        plan = replace(plan, settings=choice.settings)

    def trained(name: str, task: Task, verdict: Verdict | None, what: str) -> Trained:
        found = checkpoint.stage(
            name, lambda: Trained.of(task, verdict), Trained.stored, lambda stored: Trained.restored(task, stored)
        )
        watch.count(what, checkpoint.seconds[name])
        return found

    measured = trained("network", plan.measured, None, "training without the left-out part")
    with tempfile.TemporaryDirectory() as folder:
        before = checkpoint.bundle(
            "bundle", lambda to: measured.write(to, settling_s=0.0, test={}), Path(folder) / "bundle"
        )
        predictor = Predictor(before)
    watch.lap("exporting and checking the ONNX file")
    methods: dict[str, Method] = {}
    for baseline in plan.baselines:
        name = stage_of(baseline)
        methods[baseline.name] = checkpoint.stage(
            name,
            partial(fit_baseline, baseline, dataset, split, metric, plan.settings.degree),
            lambda found: found.stored({name: dataset.runs[name] for name in split.test_runs}),
            FittedBaseline.restored,
        ).predict
        watch.count("fitting the baselines", checkpoint.seconds[name])
    methods[NETWORK] = judged_network(predictor, dataset, metric)
    scores = compare(dataset, split.test, methods, metric)
    interval = network_interval(dataset, split.test, methods[NETWORK], predictor, metric)
    watch.lap("scoring")
    settling_s = checkpoint.stage(
        "settling_time",
        lambda: settling_time_s(predictor, dataset, metric),
        lambda found: Stored(rest={"settling_time_s": found}),
        lambda stored: float(stored.rest["settling_time_s"]),
    )
    watch.count("measuring the settling time", checkpoint.seconds["settling_time"])
    served = measured
    if plan.again:
        verdict = measured.training.verdict
        served = trained("network_of_everything", plan.served, verdict, "training on everything")
    test = {
        "left_out": split.description,
        "note": plan.note,
        "scores": {name: s.as_dict() for name, s in scores.items()},
    }
    if interval is not None:
        test["interval"] = interval.as_dict()
    bundle = served.write(out, settling_s=settling_s, test=test)
    watch.lap("exporting and checking the ONNX file")
    return Result(
        dataset.machine.name,
        bundle,
        dataset,
        metric,
        methods,
        scores,
        split.description,
        split.test,
        split.test_runs if plan.again else [],
        plan.note,
        Making(split, predictor, measured.training, served.training, watch.seconds, choice),
        interval,
        plan.notices,
    )


def evaluate_bundle(path: Path, dataset_path: Path, runs: list[str] | None) -> Result:
    """Measure a bundle's network on runs of a data set, beside no compensation.

    Raises
    ------
    InputError
        where the bundle's network does not fit the data set's machine.
    """
    bundle = load_bundle(path)
    dataset = load_dataset(dataset_path)
    if bundle.machine.terms != dataset.machine.terms:
        raise DataError(
            f"data set '{dataset_path}' must be of a machine with the bundle's error terms, got machine "
            f"'{dataset.machine.name}' for a bundle of '{bundle.machine.name}'"
        )
    chosen = list(dataset.runs) if runs is None else runs_named(dataset, runs, "--runs")
    metric = tip_metric(dataset)
    predictor = Predictor(bundle)
    methods = {NETWORK: judged_network(predictor, dataset, metric)}
    left_out = {name: np.ones(len(dataset.runs[name].time_s), dtype=bool) for name in chosen}
    scores = compare(dataset, left_out, methods, metric)
    trained = bundle.manifest.training.get("runs", [])
    same = bundle.manifest.training.get("dataset_sha256") == dataset.fingerprint
    seen = [name for name in chosen if same and name in trained]
    description = f"runs {', '.join(chosen)}" if runs is not None else f"all {len(chosen)} runs"
    note = scored_rows(dataset, left_out, metric).note
    return Result(
        bundle.machine.name,
        bundle,
        dataset,
        metric,
        methods,
        scores,
        description,
        left_out,
        seen,
        note,
        interval=network_interval(dataset, left_out, methods[NETWORK], predictor, metric),
    )
