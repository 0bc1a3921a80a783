"""Start from an earlier network: a series' or a synthetic sibling's, when a machine has few runs of its own.

The linear decoder is carried over. It and the new one share time constants and input scale, so their features are
the same, and ridge regression pulls the weights towards the earlier ones instead of towards zero. How strongly, and
whether at all, is decided by what is left on parts of the new data that were left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper

from model.bundle import Bundle, load_bundle
from model.exceptions import BundleError, DataError
from model.fields import Fields
from model.manifest import NetworkRecord
from model.network import InputScale, Prior
from model.transforms import Array
from training.dataset import DataSet

PULLS = (1.0, 3.0, 10.0, 30.0)
"""Penalties of the step away from the earlier weights that are tried, beside that of weights without one."""


@dataclass(frozen=True)
class Earlier:
    """An earlier network's linear decoder, for the coefficients of new fields.

    Attributes
    ----------
    weights, bias : shape (F, P) and (P,); zero for terms that the earlier network does not have
    scale, prior : what its features were made with
    origin : the bundle's machine and version, for the manifest
    """

    weights: Array
    bias: Array
    scale: InputScale
    prior: Prior
    origin: str


def load_earlier(path: Path, dataset: DataSet, degree: int) -> Earlier:
    """Read the network to start from out of a bundle.

    Raises
    ------
    BundleError
        where the bundle has no network, or was made before networks could be carried over.
    DataError
        where its sensors, channels or terms are not the data set's.
    """
    bundle = load_bundle(path)
    record = bundle.manifest.network
    scale = bundle.manifest.training.get("input_scale")
    prior = bundle.manifest.training.get("settings", {}).get("prior")
    if record is None or bundle.network is None:
        raise BundleError(f"bundle '{path}' must have a network to start from, got a geometric-only machine")
    if scale is None or prior is None:
        raise BundleError(f"bundle '{path}' must say how its inputs are scaled (manifest, training); train it again")
    _check(path, record, dataset)
    fields = Fields(dataset.machine, dataset.terms, degree)
    before = Fields(bundle.machine, tuple(record.terms), record.degree)
    found = {i.name: numpy_helper.to_array(i) for i in onnx.load_from_string(bundle.network).graph.initializer}
    weights, bias = np.zeros((len(found["linear"]), fields.size)), np.zeros(fields.size)
    shared = [t for t in fields.terms if t in before.terms]
    for term in shared:
        new, old = fields.slices()[term], before.slices()[term]
        width = min(new.stop - new.start, old.stop - old.start)
        weights[:, new.start : new.start + width] = found["linear"][:, old.start : old.start + width]
        bias[new.start : new.start + width] = found["bias"][old.start : old.start + width]
    if not shared:
        raise DataError(f"data set '{dataset.path}' must share error terms with bundle '{path}', got none")
    constants = {**prior, "time_constants_s": tuple(prior["time_constants_s"]), "powers": tuple(prior["powers"])}
    return Earlier(weights, bias, InputScale(**scale), Prior(**constants), _origin(bundle))


def _check(path: Path, record: NetworkRecord, dataset: DataSet) -> None:
    for what, needed, got in (
        ("sensors", record.sensors, dataset.sensors),
        ("channels", record.channels, dataset.channels),
    ):
        if list(got) != list(needed):
            missing = [n for n in needed if n not in got] or [n for n in got if n not in needed] or list(got)
            raise DataError(
                f"data set '{dataset.path}' must have the {what} of bundle '{path}', in its order: "
                f"{', '.join(needed)}; look at {', '.join(missing)}"
            )


def _origin(bundle: Bundle) -> str:
    return f"{bundle.machine.name} {bundle.version}"
