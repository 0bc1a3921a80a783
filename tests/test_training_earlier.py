"""Starting from an earlier network: it helps where the machines are alike, and does no harm where they are not."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from bundles import edit
from shop import touch, write_dataset

from model.exceptions import BundleError, DataError
from model.fields import Fields
from model.tables import read_table, write_table
from model.tip_effects import tip_effects
from training.dataset import load_dataset
from training.earlier import load_earlier
from training.information import gather
from training.job import evaluate_bundle, train_bundle

TIP = "thermal network"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("earlier")


@pytest.fixture(scope="module")
def earlier(folder: Path) -> Path:
    """A network of a machine with the same truth, trained on much."""
    train_bundle(write_dataset(folder / "much", runs=8, seed=1), folder / "bundle", None, 0)
    return folder / "bundle"


@pytest.fixture(scope="module")
def unseen(folder: Path) -> Path:
    return write_dataset(folder / "unseen", runs=6, seed=3)


def turned(data: Path) -> None:
    """Turn the sign of what was measured: no machine that the earlier network knows."""
    table = read_table(data / "error_terms.csv", text=("run", "term"))
    columns: dict[str, object] = dict(table.text)
    position = ["" if np.isnan(p) else float(p) for p in table.numbers["position"]]
    columns |= {"time_s": table.numbers["time_s"], "position": position, "value": -table.numbers["value"]}
    write_table(data / "error_terms.csv", columns)


def left_um(bundle: Path, data: Path) -> float:
    return evaluate_bundle(bundle, data, None).scores[TIP].rms_um


@pytest.mark.parametrize("tip", [False, True])
def test_a_like_machine_needs_fewer_runs(folder: Path, earlier: Path, unseen: Path, *, tip: bool) -> None:
    few = write_dataset(folder / f"few{tip}", runs=2, hours=3.0, seed=2)
    if tip:
        touch(few, 2)
        (few / "error_terms.csv").unlink()
    train_bundle(few, folder / f"alone{tip}", None, 0)
    train_bundle(few, folder / f"after{tip}", None, 0, earlier)
    assert left_um(folder / f"after{tip}", unseen) < 0.7 * left_um(folder / f"alone{tip}", unseen)
    manifest = json.loads((folder / f"after{tip}" / "manifest.json").read_text())
    assert manifest["training"]["from"].startswith("test ")
    assert manifest["training"]["pull"] is not None


def test_a_machine_that_is_unlike_starts_from_nothing(folder: Path, earlier: Path) -> None:
    data = write_dataset(folder / "unlike", runs=4, seed=5)
    unseen = write_dataset(folder / "unlike_unseen", runs=4, seed=6)
    for where in (data, unseen):
        turned(where)
    train_bundle(data, folder / "own", None, 0)
    train_bundle(data, folder / "misled", None, 0, earlier)
    assert json.loads((folder / "misled" / "manifest.json").read_text())["training"]["pull"] is None
    assert left_um(folder / "misled", unseen) <= 1.2 * left_um(folder / "own", unseen)


def test_taking_out_what_was_said_is_measuring_what_is_left(folder: Path) -> None:
    """As if the machine deviated by so much less, whether terms or the tip were measured."""
    dataset = load_dataset(write_dataset(folder / "any", runs=1, hours=1.0))
    fields = Fields(dataset.machine, dataset.terms, 2)
    rng = np.random.default_rng(4)
    q = rng.uniform([0.0, -250.0, 0.0], [800.0, 250.0, 500.0], (5, 3, 3))
    deviation = rng.normal(size=(5, 3, 3))
    targets = np.full((5, fields.size), np.nan)
    targets[:, fields.slices()["EZ0T"]] = rng.normal(size=(5, 1))
    said = rng.normal(size=(5, fields.size))
    effects = np.stack([tip_effects(fields, q[i]) for i in range(5)])
    less = gather(fields, targets - said, q, deviation - np.einsum("nmdp,np->nmd", effects, said))
    whole = gather(fields, targets, q, deviation)
    assert less is not None
    assert whole is not None
    found = whole.less(said)
    np.testing.assert_allclose(found.precision, less.precision)
    np.testing.assert_allclose(found.vector, less.vector, rtol=1e-6, atol=1e-6 * np.abs(less.vector).max())


def test_what_cannot_be_started_from_is_said(folder: Path, earlier: Path) -> None:
    data = write_dataset(folder / "other", runs=2)
    dataset = load_dataset(data)
    old = shutil.copytree(earlier, folder / "old")
    edit(Path(old), lambda m: m["training"].pop("input_scale"))
    with pytest.raises(BundleError, match="must say how its inputs are scaled"):
        load_earlier(old, dataset, 3)
    table = read_table(data / "telemetry.csv", text=("run",))
    columns: dict[str, object] = {"run": table.text["run"]}
    columns |= {n: v for n, v in table.numbers.items() if n != "spindle_rpm"}
    write_table(data / "telemetry.csv", columns)
    with pytest.raises(DataError, match="must have the channels of bundle .* look at spindle_rpm"):
        load_earlier(earlier, load_dataset(data), 3)
