"""A bundle: the folder that training writes and the service loads.

`machine.toml`, `network.onnx` (absent for a geometric-only machine), `geometry.csv` and `manifest.json`, which
holds the SHA-256 of the others. Nothing in it is executed.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from model.error_map import ErrorMap, Row
from model.error_tables import read_error_table, write_error_table
from model.exceptions import BundleError
from model.machine import Machine, load_machine
from model.manifest import FORMAT_VERSION, Manifest, NetworkRecord
from model.sensors import is_covariance
from model.validation import check

MACHINE, NETWORK, GEOMETRY, MANIFEST = "machine.toml", "network.onnx", "geometry.csv", "manifest.json"


@dataclass(frozen=True)
class Bundle:
    """A verified bundle.

    Attributes
    ----------
    version : first twelve digits of the manifest's SHA-256, which covers all files
    network : the ONNX file's bytes, None for a geometric-only machine
    """

    path: Path
    version: str
    machine: Machine
    manifest: Manifest
    geometry: ErrorMap
    network: bytes | None


def load_bundle(path: str | Path) -> Bundle:
    """Read a bundle and verify its checksums and contents.

    Raises
    ------
    BundleError
        where a file is missing, changed, unknown or does not fit the others; it names the file.
    """
    path = Path(path)
    where = f"bundle '{path}'"
    if not path.is_dir():
        raise BundleError(f"{where} must be a folder with {MACHINE} and {MANIFEST}; there is none")
    raw = _read(path / MANIFEST, where)
    try:
        data: Any = json.loads(raw)
    except ValueError as problem:
        raise BundleError(f"{where}: {MANIFEST} is not JSON: {problem}") from None
    if not isinstance(data, dict):
        raise BundleError(f"{where}: {MANIFEST} must be an object, got {_kind(data)}; export it again")
    if data.get("format_version") != FORMAT_VERSION:
        raise BundleError(
            f"{where} has format version {data.get('format_version')!r}, this release reads {FORMAT_VERSION}; "
            "export it again with `thermotrue train`"
        )
    manifest = check(Manifest, data, f"{where}, {MANIFEST}", BundleError)
    _check_files(path, manifest, where)
    machine = load_machine(path)
    if manifest.machine != machine.name:
        raise BundleError(f"{where}: {MANIFEST} is for machine '{manifest.machine}', {MACHINE} for '{machine.name}'")
    network = _read(path / NETWORK, where) if NETWORK in manifest.files else None
    if (network is None) != (manifest.network is None):
        raise BundleError(f"{where}: {NETWORK} and the manifest's 'network' must come together; export it again")
    if manifest.network is not None:
        _check_network(manifest.network, machine, where)
    rows = read_error_table(path / GEOMETRY) if GEOMETRY in manifest.files else []
    geometry = ErrorMap.from_rows(machine, rows, f"{where}, {GEOMETRY}")
    return Bundle(path, hashlib.sha256(raw).hexdigest()[:12], machine, manifest, geometry, network)


def write_bundle(
    path: str | Path,
    machine: Machine,
    *,
    geometry: Iterable[Row] = (),
    network: bytes | None = None,
    record: NetworkRecord | None = None,
    training: dict[str, Any] | None = None,
    test: dict[str, Any] | None = None,
) -> Bundle:
    """Write a bundle whole or not at all, replacing an older bundle at `path`, and load it again.

    Raises
    ------
    BundleError
        where `path` exists and is not a bundle, or cannot be written.
    """
    path = Path(path)
    check_free(path)
    try:
        return _write(path, machine, geometry, network, record, training or {}, test or {})
    except OSError as problem:
        raise BundleError(f"bundle '{path}' cannot be written: {_reason(problem)}") from None


def check_free(path: str | Path) -> None:
    """Check that a bundle could be written: nothing is there, or an older bundle.

    Raises
    ------
    BundleError
        where `path` exists and is not a bundle, or lies in what is not a folder.
    """
    path = Path(path)
    try:
        if path.exists() and not (path / MANIFEST).is_file() and (not path.is_dir() or any(path.iterdir())):
            raise BundleError(f"'{path}' exists and is not a bundle; name another folder")
        there = next(p for p in path.absolute().parents if p.exists())
    except OSError as problem:
        raise BundleError(f"bundle '{path}' cannot be written: {_reason(problem)}") from None
    if not there.is_dir():
        raise BundleError(f"bundle '{path}' cannot be written: '{there}' is a file; name a folder")
    if not os.access(there, os.W_OK | os.X_OK):
        raise BundleError(f"bundle '{path}' cannot be written: no permission to write in '{there}'")


def _write(
    path: Path,
    machine: Machine,
    geometry: Iterable[Row],
    network: bytes | None,
    record: NetworkRecord | None,
    training: dict[str, Any],
    test: dict[str, Any],
) -> Bundle:
    path.parent.mkdir(parents=True, exist_ok=True)
    staging = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    try:
        (staging / MACHINE).write_text(machine.source, encoding="utf-8")
        write_error_table(staging / GEOMETRY, geometry)
        if network is not None:
            (staging / NETWORK).write_bytes(network)
        files = {f.name: hashlib.sha256(f.read_bytes()).hexdigest() for f in sorted(staging.iterdir())}
        manifest = Manifest(
            format_version=FORMAT_VERSION,
            machine=machine.name,
            files=files,
            network=record,
            training=training,
            test=test,
        )
        text = json.dumps(manifest.model_dump(mode="json"), indent=1, allow_nan=False)
        (staging / MANIFEST).write_text(text + "\n", encoding="utf-8")
        load_bundle(staging)
        staging.chmod(0o755)  # mkdtemp's 0700 would keep the service's own user out
        _swap(staging, path)
    except BaseException:
        shutil.rmtree(staging, ignore_errors=True)
        raise
    return load_bundle(path)


def _swap(staging: Path, path: Path) -> None:
    """Put the new folder in the old one's place; the old one is gone only once the new one stands."""
    if not path.exists():
        staging.rename(path)
        return
    retired = staging.with_name(staging.name + "-old")
    path.rename(retired)
    try:
        staging.rename(path)
    except OSError:
        retired.rename(path)
        raise
    shutil.rmtree(retired)


def machine_of(path: str | Path) -> Machine:
    """Return the machine of a TOML file, bundle or data set, verifying a bundle's checksums."""
    return load_bundle(path).machine if (Path(path) / MANIFEST).is_file() else load_machine(path)


def _reason(problem: OSError) -> str:
    return problem.strerror or str(problem)


def _kind(data: Any) -> str:
    kinds = {list: "a list", str: "a text", bool: "true or false", int: "a number", float: "a number"}
    return kinds.get(type(data), "nothing")


def _read(file: Path, where: str) -> bytes:
    try:
        return file.read_bytes()
    except OSError as problem:
        raise BundleError(f"{where}: {file.name} cannot be read: {problem.strerror}") from None


def _check_files(path: Path, manifest: Manifest, where: str) -> None:
    known = {MACHINE, NETWORK, GEOMETRY}
    for name, expected in manifest.files.items():
        if name not in known:
            raise BundleError(f"{where}: {MANIFEST} lists '{name}'; a bundle has only {', '.join(sorted(known))}")
        if hashlib.sha256(_read(path / name, where)).hexdigest() != expected:
            raise BundleError(f"{where}: {name} does not match {MANIFEST} (sha256 differs); export it again")
    for name in known:
        if name not in manifest.files and (name == MACHINE or (path / name).exists()):
            raise BundleError(f"{where}: {MANIFEST} has no checksum of {name}; export it again")


def _check_network(record: NetworkRecord, machine: Machine, where: str) -> None:
    for sensor in record.sensors:
        if sensor not in machine.sensors:
            raise BundleError(f"{where}: the network needs sensor '{sensor}', which {MACHINE} does not have")
        if sensor not in record.valid_range_degC:
            raise BundleError(f"{where}: {MANIFEST} has no valid temperature range for sensor '{sensor}'")
    for channel in record.channels:
        if channel not in record.valid_range_channels:
            raise BundleError(f"{where}: {MANIFEST} has no range of values for channel '{channel}'")
    for name in record.terms:
        machine.term(name)
    count = len(record.sensors)
    shape = [len(row) for row in record.sensor_covariance_K2]
    if len(record.sensor_mean_degC) != count or shape != [count] * count:
        raise BundleError(f"{where}: {MANIFEST}: sensor statistics must be those of its {count} sensors")
    if not is_covariance(np.array(record.sensor_covariance_K2)):
        raise BundleError(f"{where}: {MANIFEST}: sensor_covariance_K2 must be symmetric and positive semidefinite")
