"""What a long training has found so far, on disk, so that it goes on after a kill where it was.

The work is a row of stages. What a stage found is one file, `NAME.npz` (arrays, and the rest as JSON inside; no
pickles), that takes its name only when it is whole and on disk. Each file says of what it was made: data, settings,
seed and program. What was made of something else is never taken up.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import sys
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from secrets import token_hex
from typing import Any, TypeVar

import numpy as np

from model.bundle import Bundle, load_bundle
from model.exceptions import BundleError, DataError
from model.transforms import Array

Found = TypeVar("Found")

FORMAT = 1
MARK = "checkpoint.json"
"""Says what the files of the folder were made of; a folder without it is not ours."""
TEXT = "json"
"""Name of the array that holds what is not an array."""
LOCK = "lock"
"""Held by the training that works in the folder; a kill lets go of it."""
PACKAGES = ("training", "model")
"""Whose source decides what a training gives."""
LIBRARIES = ("thermotrue", "numpy", "scipy", "scikit-learn", "torch", "onnx", "onnxruntime")


@dataclass(frozen=True)
class Stored:
    """What a stage found, as it goes to disk.

    Attributes
    ----------
    arrays : by name
    rest : of what JSON knows
    """

    arrays: dict[str, Array] = field(default_factory=dict)
    rest: dict[str, Any] = field(default_factory=dict)


class Checkpoint:
    """The stages of a training that are done.

    Parameters
    ----------
    folder : where they are kept; None keeps nothing
    fresh : forget what an earlier training left there

    Raises
    ------
    DataError
        where the folder is somebody's own.
    """

    def __init__(self, folder: Path | None, *, fresh: bool = False) -> None:
        self.folder, self._fresh = folder, fresh
        self._key = ""
        self._stages: tuple[str, ...] = ()
        self._lock: int | None = None
        self.seconds: dict[str, float] = {}
        if folder is not None:
            _check_ours(folder)

    def begin(self, made_of: Mapping[str, Any], stages: Sequence[str]) -> None:
        """Take up what was made of the same, forget what was made of something else.

        A sentence on stderr says which.

        Parameters
        ----------
        made_of : all that the stages' results depend on, by name, as JSON knows it
        stages : names of all stages, in order
        """
        text = json.dumps(dict(made_of), sort_keys=True, allow_nan=False)
        self._key, self._stages = hashlib.sha256(text.encode()).hexdigest(), tuple(stages)
        if self.folder is None:
            return
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._take_lock()
            before = _read_mark(self.folder)
            other = [] if before is None else _differences(before, json.loads(text))
            if before is not None and not other and not self._fresh:
                if self.done:
                    _say(f"continuing from {self.folder} ({self})")
                return
            if other and not self._fresh:
                _say(f"{self.folder} was made with other {' and '.join(other)}; starting anew")
            self._empty()
            _write(self.folder / MARK, json.dumps({"format": FORMAT, "of": json.loads(text)}, indent=1).encode())
        except OSError as problem:
            raise DataError(f"checkpoint '{self.folder}' cannot be written: {problem.strerror or problem}") from None

    @property
    def done(self) -> int:
        """How many stages are done."""
        if self.folder is None:
            return 0
        return sum(self._there(name) for name in self._stages)

    def leave(self) -> str:
        """Stop before the end, and return what to say of that; a folder without a stage is forgotten."""
        if self.folder is None or not self.done:
            self.remove()
            return "interrupted before a stage was done; nothing was written"
        served = next((name for name in self._stages if (self.folder / name).is_dir()), None)
        usable = "" if served is None else f", and {self.folder / served} is a bundle without the left-out part"
        return f"interrupted; the same command goes on from {self.folder} ({self}){usable}"

    def __str__(self) -> str:
        return f"{self.done} of {len(self._stages)} stages done"

    def stage(
        self, name: str, work: Callable[[], Found], pack: Callable[[Found], Stored], unpack: Callable[[Stored], Found]
    ) -> Found:
        """Return what a stage found, now or before.

        Both ways it is what `unpack` makes of the stored form, so that going on cannot differ from not having stopped.
        """
        assert name in self._stages, name
        data = self._read(name)
        if data is None:
            begin = time.monotonic()
            stored = pack(work())
            data = _pack(stored, self._key, time.monotonic() - begin)
            if self.folder is not None:
                self._write(f"{name}.npz", data)
        stored, _, self.seconds[name] = _unpack(data)
        return unpack(stored)

    def bundle(self, name: str, work: Callable[[Path], Bundle], elsewhere: Path) -> Bundle:
        """Return the bundle of a stage, now or before: a folder that can be served as it is.

        Parameters
        ----------
        work : writes it into a folder
        elsewhere : the folder, where nothing is kept
        """
        assert name in self._stages, name
        path = elsewhere if self.folder is None else self.folder / name
        if self.folder is not None:
            try:
                return load_bundle(path)
            except BundleError:  # none yet, or damaged: made anew
                shutil.rmtree(path, ignore_errors=True)
        begin = time.monotonic()
        found = work(path)
        self.seconds[name] = time.monotonic() - begin
        return found

    def remove(self) -> None:
        """Forget all stages, when the work is done."""
        if self.folder is None or self._lock is None:
            return
        shutil.rmtree(self.folder)
        os.close(self._lock)
        self._lock = None

    def _take_lock(self) -> None:
        assert self.folder is not None
        if self._lock is not None:
            return
        lock = os.open(self.folder / LOCK, os.O_CREAT | os.O_RDWR, 0o644)
        try:
            import fcntl  # noqa: PLC0415 (not on Windows, where two trainings into one folder are not noticed)

            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:
            pass
        except OSError:
            os.close(lock)
            raise DataError(
                f"'{self.folder}' is in use by another training; wait for it or name another --out"
            ) from None
        self._lock = lock

    def _empty(self) -> None:
        """Delete all but the lock; the mark last, so that a kill in between leaves what is known to be ours."""
        assert self.folder is not None
        for path in sorted(self.folder.iterdir(), key=lambda path: path.name == MARK):
            if path.name == LOCK:
                continue
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()

    def _there(self, name: str) -> bool:
        assert self.folder is not None
        return (self.folder / f"{name}.npz").is_file() or (self.folder / name).is_dir()

    def _read(self, name: str) -> bytes | None:
        """Return a stage's file, or None where there is none that is whole and of the same."""
        if self.folder is None:
            return None
        file = self.folder / f"{name}.npz"
        try:
            data = file.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as problem:
            raise DataError(f"checkpoint '{file}' cannot be read: {problem.strerror}; give --fresh") from None
        try:
            key = _unpack(data)[1]
        except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile):
            _say(f"{file} is damaged; that stage is done anew")
            return None
        return data if key == self._key else None

    def _write(self, name: str, data: bytes) -> None:
        assert self.folder is not None
        try:
            _write(self.folder / name, data)
        except OSError as problem:
            reason = problem.strerror or str(problem)
            raise DataError(
                f"checkpoint '{self.folder}' cannot be written: {reason}; see that there is space"
            ) from None


def checkpoint_path(bundle: Path) -> Path:
    """Return where the checkpoint of a bundle goes: beside its folder, `out/vmc3.checkpoint` for `out/vmc3`."""
    bundle = Path(os.path.normpath(bundle))
    return bundle.with_name(bundle.name + ".checkpoint")


def program() -> dict[str, str]:
    """Return what computes: versions of the libraries, and a digest of the source that a training runs through."""
    digest = hashlib.sha256()
    root = Path(__file__).parents[1]
    for package in PACKAGES:
        for file in sorted((root / package).rglob("*.py")):
            digest.update(str(file.relative_to(root)).encode())
            digest.update(file.read_bytes())
    return {**{name: version(name) for name in LIBRARIES}, "source": digest.hexdigest()}


def _check_ours(folder: Path) -> None:
    try:
        if not folder.exists():
            return
        if not folder.is_dir() or not ((folder / MARK).is_file() or all(_passing(f.name) for f in folder.iterdir())):
            raise DataError(f"'{folder}' exists and is not a training's checkpoint; name another --out")
    except OSError as problem:
        raise DataError(f"checkpoint '{folder}' cannot be read: {problem.strerror}") from None


def _say(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)


def _passing(name: str) -> bool:
    return name == LOCK or name.endswith(".part")


def _read_mark(folder: Path) -> dict[str, Any] | None:
    """Return what a checkpoint was made of; of another format or damaged, nothing that could be the same."""
    try:
        found = json.loads((folder / MARK).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        return {}
    if not isinstance(found, dict) or found.get("format") != FORMAT or not isinstance(found.get("of"), dict):
        return {}
    of: dict[str, Any] = found["of"]
    return of


def _differences(before: dict[str, Any], now: dict[str, Any]) -> list[str]:
    return [name for name in {**before, **now} if before.get(name) != now.get(name)]


def _pack(stored: Stored, key: str, seconds: float) -> bytes:
    assert TEXT not in stored.arrays
    # Text as bytes: a zip of plain arrays, which NumPy reads without pickles.
    text = json.dumps({"key": key, "seconds": seconds, "rest": stored.rest}, allow_nan=False).encode()
    file = io.BytesIO()
    np.savez(file, **{TEXT: np.frombuffer(text, dtype=np.uint8)}, **stored.arrays)  # type: ignore[arg-type]
    return file.getvalue()


def _unpack(data: bytes) -> tuple[Stored, str, float]:
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    text = json.loads(arrays.pop(TEXT).tobytes())
    return Stored(arrays, text["rest"]), text["key"], text["seconds"]


def _write(file: Path, data: bytes) -> None:
    """Write a file that is there whole or not at all, also after a power cut."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(f".{file.name}.{token_hex(4)}.part")
    try:
        with part.open("xb") as out:
            out.write(data)
            out.flush()
            os.fsync(out.fileno())
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)
