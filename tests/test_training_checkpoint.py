"""A training that is killed goes on where it was, to the same bundle."""

import json
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from shop import write_dataset

from model.bundle import load_bundle
from model.exceptions import DataError
from training.checkpoint import MARK, Checkpoint, Stored, checkpoint_path
from training.job import train_bundle
from training.plan import plan_training

LISTENING = "import os, signal, sys; signal.signal(signal.SIGINT, signal.SIG_DFL); os.execvp(sys.argv[1], sys.argv[1:])"
"""Runs a command that listens to Ctrl-C, even where the tests run in the background and ignore it."""
THERMOTRUE = str(Path(sys.executable).with_name("thermotrue"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("kill") / "data", 3, 4.0)


@pytest.fixture(scope="module")
def whole(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bundle of a training that nothing stopped and that kept nothing."""
    return train_bundle(folder, tmp_path_factory.mktemp("whole") / "bundle", None, 0).bundle.path


def command(folder: Path, out: Path, *more: str) -> list[str]:
    return [sys.executable, "-c", LISTENING, THERMOTRUE, "train", str(folder), "--out", str(out), "--no-report", *more]


def files(bundle: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in bundle.iterdir()}


def stop_after(name: str, folder: Path, out: Path, how: signal.Signals) -> tuple[int, str]:
    """Start a training and stop it once a stage is on disk; return its exit code and what it said."""
    with subprocess.Popen(
        command(folder, out), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        deadline = time.monotonic() + 120.0
        while not (checkpoint_path(out) / name).exists() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.005)
        time.sleep(random.uniform(0.0, 0.3))  # anywhere in what comes next  # noqa: S311
        process.send_signal(how)
        _, said = process.communicate(timeout=60)
    return process.returncode, said


def test_after_kills_and_ctrl_c_the_same_command_gives_the_same_bundle(
    folder: Path, whole: Path, tmp_path: Path
) -> None:
    out = tmp_path / "bundle"
    kept = checkpoint_path(out)
    assert stop_after("network.npz", folder, out, signal.SIGKILL)[0] == -signal.SIGKILL

    code, said = stop_after("bundle", folder, out, signal.SIGINT)
    assert code == 130, said
    assert said.splitlines()[-1].startswith(f"thermotrue: interrupted; the same command goes on from {kept} (")
    assert said.rstrip().endswith(f"stages done), and {kept / 'bundle'} is a bundle without the left-out part")
    runs = load_bundle(kept / "bundle").manifest.training["runs"]
    assert runs == plan_training(folder, out, None, 0).split.train_runs
    assert not out.exists()

    assert stop_after("network_of_everything.npz", folder, out, signal.SIGKILL)[0] == -signal.SIGKILL
    assert not out.exists()
    done = subprocess.run(command(folder, out), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    stages = len(plan_training(folder, out, None, 0).stages)
    assert f"continuing from {kept} ({stages} of {stages} stages done)" in done.stderr.replace("\n", "")
    assert files(out) == files(whole)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bundle"]


def test_what_fails_before_a_stage_is_done_leaves_nothing(tmp_path: Path) -> None:
    checkpoint = begun(tmp_path / "x.checkpoint")
    assert checkpoint.leave() == "interrupted before a stage was done; nothing was written"
    assert list(tmp_path.iterdir()) == []
    checkpoint = begun(tmp_path / "x.checkpoint")
    take(checkpoint, "one", 1.0)
    assert checkpoint.leave().endswith("x.checkpoint (1 of 2 stages done)")
    assert (tmp_path / "x.checkpoint" / "one.npz").is_file()


def begun(folder: Path, data: str = "a", *, fresh: bool = False) -> Checkpoint:
    checkpoint = Checkpoint(folder, fresh=fresh)
    checkpoint.begin({"data": data, "settings": {"seed": 0}}, ["one", "two"])
    return checkpoint


def take(checkpoint: Checkpoint, name: str, value: float) -> float:
    return checkpoint.stage(
        name,
        lambda: value,
        lambda found: Stored({"value": np.array([found])}, {"text": "µm"}),
        lambda stored: float(stored.arrays["value"][0]),
    )


def let_go(checkpoint: Checkpoint) -> None:
    """Let go of the lock, as a kill does."""
    import os

    assert checkpoint._lock is not None
    os.close(checkpoint._lock)


def test_what_was_made_of_other_data_is_never_taken_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = tmp_path / "x.checkpoint"
    first = begun(kept)
    assert take(first, "one", 1.0) == 1.0
    stale = (kept / "one.npz").read_bytes()
    let_go(first)
    again = begun(kept)
    assert f"continuing from {kept} (1 of 2 stages done)" in capsys.readouterr().err
    assert take(again, "one", 9.0) == 1.0
    let_go(again)
    other = begun(kept, "b")
    assert capsys.readouterr().err == f"{kept} was made with other data; starting anew\n"
    (kept / "one.npz").write_bytes(stale)
    assert take(other, "one", 2.0) == 2.0
    let_go(other)
    fresh = begun(kept, "b", fresh=True)
    assert take(fresh, "one", 3.0) == 3.0
    fresh.remove()
    assert not kept.exists()


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 not a zip", None])
def test_a_damaged_stage_is_done_anew(tmp_path: Path, damage: bytes | None, capsys: pytest.CaptureFixture[str]) -> None:
    kept = tmp_path / "x.checkpoint"
    checkpoint = begun(kept)
    take(checkpoint, "one", 1.0)
    file = kept / "one.npz"
    file.write_bytes(file.read_bytes()[:-40] if damage is None else damage)
    assert take(checkpoint, "one", 4.0) == 4.0
    assert f"{file} is damaged; that stage is done anew" in capsys.readouterr().err


def test_two_trainings_do_not_share_a_checkpoint(tmp_path: Path) -> None:
    kept = tmp_path / "x.checkpoint"
    first = begun(kept)
    with pytest.raises(DataError, match=r"'.*x.checkpoint' is in use by another training; wait for it or name another"):
        begun(kept)
    first.remove()
    begun(kept).remove()


def test_a_folder_of_ones_own_is_not_touched(tmp_path: Path) -> None:
    mine = tmp_path / "x.checkpoint"
    mine.mkdir()
    (mine / "thesis.txt").write_text("precious")
    with pytest.raises(DataError, match=r"'.*' exists and is not a training's checkpoint; name another --out"):
        Checkpoint(mine)
    assert (mine / "thesis.txt").read_text() == "precious"


def test_a_mark_of_another_release_starts_anew(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = tmp_path / "x.checkpoint"
    first = begun(kept)
    take(first, "one", 1.0)
    let_go(first)
    mark = json.loads((kept / MARK).read_text())
    (kept / MARK).write_text(json.dumps({**mark, "format": 99}))
    assert begun(kept).done == 0
    assert "starting anew" in capsys.readouterr().err
    shutil.rmtree(kept)


def test_all_that_a_network_depends_on_is_in_the_key(folder: Path, tmp_path: Path) -> None:
    def made_of(*args: object, data: Path = folder) -> str:
        return json.dumps(plan_training(data, tmp_path / "b", *args).made_of, sort_keys=True)  # type: ignore[arg-type]

    usual = made_of(None, 0)
    assert made_of(None, 0) == usual
    changed = tmp_path / "data"
    shutil.copytree(folder, changed)
    with (changed / "machine.toml").open("a") as file:
        file.write("\n# another machine\n")
    others = {made_of(None, 1), made_of(["r1"], 0), made_of(["r2"], 0), made_of(None, 0, data=changed)}
    assert len(others | {usual}) == 5
