"""A network trained on one part of a data set, and what its bundle says of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from model.bundle import Bundle
from model.exceptions import ComputeError
from model.fields import Fields
from model.manifest import UncertaintyRecord
from model.network import InputScale, Prior, Residual, ThermalNetwork
from model.sensors import SensorModel
from model.transforms import Array
from training.checkpoint import Stored
from training.choice import Choice, choose
from training.dataset import DataSet
from training.earlier import Earlier
from training.export import write_network
from training.lost_sensors import learn_lost_sensors
from training.samples import Samples
from training.split import Split
from training.tip import TipMetric
from training.trainer import Settings, Training, Verdict, train_network
from training.uncertainty import estimate


@dataclass(frozen=True)
class Task:
    """What a network is trained on.

    Attributes
    ----------
    split : only its training part is looked at
    earlier : network to start from
    """

    dataset: DataSet
    split: Split
    metric: TipMetric
    settings: Settings
    earlier: Earlier | None = None

    @property
    def prior(self) -> Prior:
        """Sizes and time constants of the modes."""
        return self.settings.prior if self.earlier is None else self.earlier.prior

    @property
    def sensor_model(self) -> SensorModel:
        """What fills in readings that are missing."""
        return SensorModel.fit(
            np.concatenate([self.dataset.runs[n].telemetry.temperatures for n in self.split.train_runs])
        )

    def chosen(self) -> Choice:
        """Return the settings that runs left out of the training part choose."""
        return choose(self.dataset, self.split, self.metric, self.sensor_model, self.settings)


@dataclass(frozen=True)
class Trained:
    """A network trained on one part of a data set, and what its bundle says of it."""

    task: Task
    sensor_model: SensorModel
    training: Training
    uncertainty: UncertaintyRecord | None

    @classmethod
    def of(cls, task: Task, verdict: Verdict | None = None) -> Trained:
        """Train a network; `verdict` is that of an earlier training on part of the same data.

        Raises
        ------
        DataError, ComputeError
            as `trainer.train_network`.
        """
        sensors, settings = task.sensor_model, task.settings
        training = train_network(task.dataset, task.split, task.metric, sensors, settings, verdict, task.earlier)
        uncertainty = estimate(
            task.dataset,
            task.split,
            task.metric,
            training.net,
            training.fields,
            sensors,
            training.solve,
            ridge=settings.ridge,
            correlation_s=settings.correlation_s,
        )
        return cls(task, sensors, training, uncertainty)

    def stored(self) -> Stored:
        """Return it for a checkpoint."""
        training = self.training
        arrays: dict[str, Array] = {f"net.{n}": t.detach().numpy() for n, t in training.net.state_dict().items()}
        arrays |= {f"curve.{i}": np.array(curve) for i, curve in enumerate(training.curves)}
        rest = {
            "verdict": asdict(training.verdict),
            "scale": asdict(training.scale),
            "pull": training.pull,
            "uncertainty": None if self.uncertainty is None else self.uncertainty.model_dump(mode="json"),
        }
        return Stored(arrays, rest)

    @classmethod
    def restored(cls, task: Task, stored: Stored) -> Trained:
        """Return what `stored` keeps. Its `training.solve` is gone: the decoder is not fitted again."""
        rest = stored.rest
        weights = {name[4:]: torch.tensor(v) for name, v in stored.arrays.items() if name.startswith("net.")}
        fields = Fields(task.dataset.machine, task.dataset.terms, task.settings.degree)
        net = ThermalNetwork(InputScale(**rest["scale"]), task.prior, fields.size)
        if "residual.down" in weights:
            net.residual = Residual(
                weights["residual.down"], weights["residual.up"], len(weights["residual.enter.bias"])
            )
        net.load_state_dict(weights)
        curves = [
            stored.arrays[f"curve.{i}"].tolist() for i in range(sum(n.startswith("curve.") for n in stored.arrays))
        ]
        scale, verdict = InputScale(**rest["scale"]), Verdict(**rest["verdict"])
        training = Training(net, fields, verdict, scale, _gone, curves, rest["pull"])
        record = rest["uncertainty"]
        uncertainty = None if record is None else UncertaintyRecord.model_validate(record)
        return cls(task, task.sensor_model, training, uncertainty)

    def write(self, path: Path, *, settling_s: float, test: dict[str, Any]) -> Bundle:
        """Write the bundle."""
        task, training = self.task, self.training
        return write_network(
            path,
            task.dataset,
            training.net,
            training.fields,
            self.sensor_model,
            task.split.train_runs,
            settling_time_s=settling_s,
            training={
                "dataset": task.dataset.path.name,
                "dataset_sha256": task.dataset.fingerprint,
                "runs": task.split.train_runs,
                "measurements": int(sum(mask.sum() for mask in task.split.train.values())),
                "settings": task.settings.as_dict(),
                "residual": asdict(training.verdict),
                "input_scale": asdict(training.scale),
                **({} if task.earlier is None else {"from": task.earlier.origin, "pull": training.pull}),
            },
            test=test,
            uncertainty=self.uncertainty,
            lost_sensors=learn_lost_sensors(
                task.dataset,
                task.split,
                task.metric,
                training.net,
                training.fields,
                self.sensor_model,
            ),
        )


def _gone(_samples: Samples) -> tuple[Array, Array]:
    raise ComputeError("a network from a checkpoint cannot fit its decoder again; train it anew")
