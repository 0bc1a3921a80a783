"""A training job from data set to bundle, and the evaluation of a bundle."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from model.bundle import Bundle, check_free, load_bundle
from model.exceptions import DataError
from model.predictor import Predictor
from model.sensors import SensorModel
from training.baselines import fit_ridge
from training.dataset import DataSet, load_dataset, runs_named
from training.earlier import Earlier, load_earlier
from training.evaluation import NETWORK, NO_COMPENSATION, RIDGE, Method, Score, compare, scored_rows
from training.export import write_network
from training.interval import Interval, network_interval
from training.making import Making, Stopwatch
from training.settling import settling_time_s
from training.split import Mask, Split, default_split, everything, split_by_run
from training.tip import TipMetric, tip_metric
from training.tip_methods import judged_network, on_terms
from training.trainer import Settings, Verdict, train_network
from training.uncertainty import estimate


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


def train_bundle(path: Path, out: Path, test_runs: list[str] | None, seed: int, start: Path | None = None) -> Result:
    """Train, measure on left-out data and write a bundle.

    With `test_runs` named, these stay out of the bundle's network. Without, the default split measures the network,
    and the bundle's network is trained again on everything: a customer's few runs are too dear to leave out.
    `start` is a bundle whose network to start from.

    Raises
    ------
    InputError
        for wrong data, before anything is written.
    """
    torch.set_num_threads(1)  # the tensors are small; threads would wait for each other
    check_free(out)
    watch = Stopwatch()
    dataset = load_dataset(path)
    watch.lap("reading the data set")
    split = (
        default_split(dataset, seed)
        if test_runs is None
        else split_by_run(dataset, runs_named(dataset, test_runs, "--test-runs"))
    )
    metric = tip_metric(dataset)
    compare(dataset, split.test, {}, metric)  # is there something to test on? That is better known before training
    settings = Settings(seed=seed)
    earlier = None if start is None else load_earlier(start, dataset, settings.degree)
    final = everything(dataset) if test_runs is None else split
    measured = trained = _Trained(dataset, split, metric, settings, earlier=earlier)
    watch.lap("training without the left-out part")
    with tempfile.TemporaryDirectory() as folder:
        predictor = Predictor(trained.write(Path(folder) / "bundle", settling_s=0.0, test={}))
    watch.lap("exporting and checking the ONNX file")
    sensor_model = trained.sensor_model
    ridge = on_terms(
        lambda terms, grid: fit_ridge(terms, split, grid, sensor_model).predict, dataset, metric, settings.degree
    )
    watch.lap("fitting the baselines")
    methods = {RIDGE: ridge, NETWORK: judged_network(predictor, dataset, metric)}
    scores = compare(dataset, split.test, methods, metric)
    interval = network_interval(dataset, split.test, methods[NETWORK], predictor, metric)
    watch.lap("scoring")
    settling_s = settling_time_s(predictor, dataset, metric)
    watch.lap("measuring the settling time")
    if test_runs is None:
        trained = _Trained(dataset, final, metric, settings, trained.verdict, earlier)
        watch.lap("training on everything")
    note = scored_rows(dataset, split.test, metric).note
    test = {"left_out": split.description, "note": note, "scores": {name: s.as_dict() for name, s in scores.items()}}
    if interval is not None:
        test["interval"] = interval.as_dict()
    bundle = trained.write(out, settling_s=settling_s, test=test)
    watch.lap("exporting and checking the ONNX file")
    making = Making(split, predictor, measured.training, trained.training, watch.seconds)
    seen = split.test_runs if test_runs is None else []
    left_out = split.description
    return Result(
        dataset.machine.name,
        bundle,
        dataset,
        metric,
        methods,
        scores,
        left_out,
        split.test,
        seen,
        note,
        making,
        interval,
    )


class _Trained:
    """A network trained on one part of a data set, and what its bundle says of it."""

    def __init__(
        self,
        dataset: DataSet,
        split: Split,
        metric: TipMetric,
        settings: Settings,
        verdict: Verdict | None = None,
        earlier: Earlier | None = None,
    ) -> None:
        self._dataset, self._split, self._settings, self._earlier = dataset, split, settings, earlier
        readings = [dataset.runs[name].telemetry.temperatures for name in split.train_runs]
        self.sensor_model = SensorModel.fit(np.concatenate(readings))
        self.training = train_network(dataset, split, metric, self.sensor_model, settings, verdict, earlier)
        self.uncertainty = estimate(
            dataset,
            split,
            metric,
            self.training.net,
            self.training.fields,
            self.sensor_model,
            self.training.solve,
            ridge=settings.ridge,
            correlation_s=settings.correlation_s,
        )

    @property
    def verdict(self) -> Verdict:
        """Whether the nonlinear residual was kept."""
        return self.training.verdict

    def write(self, path: Path, *, settling_s: float, test: dict[str, Any]) -> Bundle:
        """Write the bundle."""
        dataset = self._dataset
        return write_network(
            path,
            dataset,
            self.training.net,
            self.training.fields,
            self.sensor_model,
            self._split.train_runs,
            settling_time_s=settling_s,
            training={
                "dataset": dataset.path.name,
                "dataset_sha256": dataset.fingerprint,
                "runs": self._split.train_runs,
                "measurements": int(sum(mask.sum() for mask in self._split.train.values())),
                "settings": self._settings.as_dict(),
                "residual": asdict(self.verdict),
                "input_scale": asdict(self.training.scale),
                **({} if self._earlier is None else {"from": self._earlier.origin, "pull": self.training.pull}),
            },
            test=test,
            uncertainty=self.uncertainty,
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
