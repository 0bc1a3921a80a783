"""A bundle: the folder that training writes and the service loads.

`machine.toml`, `network.onnx` (absent for a geometric-only machine), `geometry.csv` and `manifest.json`, which
holds the SHA-256 of the others and a digest of itself. Nothing in it is executed. Checksums and digest protect from
damage and from edits by mistake; whoever wants to deceive can compute them anew, and is kept out by other means.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import tempfile
from collections import OrderedDict
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from model.error_map import ErrorMap, Row
from model.error_tables import read_error_table, write_error_table
from model.exceptions import BundleError, MachineError
from model.machine import Machine, load_machine, parse_machine
from model.manifest import FORMAT_VERSION, Manifest, NetworkRecord
from model.manifest_checks import check_network
from model.manifest_text import parsed_manifest

MACHINE, NETWORK, GEOMETRY, MANIFEST = "machine.toml", "network.onnx", "geometry.csv", "manifest.json"
MEGABYTE = 1024 * 1024
MAX_BYTES = {MACHINE: MEGABYTE // 4, NETWORK: 32 * MEGABYTE, GEOMETRY: 8 * MEGABYTE, MANIFEST: 8 * MEGABYTE}
"""The files that a bundle has, and how large each may be: tens of times what the largest machines here need."""
UNSEALED = "0" * 64
"""Stands in the digest's place while it is computed."""


@dataclass(frozen=True)
class Bundle:
    """A verified bundle.

    Attributes
    ----------
    path : its folder; where it does not come from one, what names it in messages
    version : first twelve digits of the manifest's digest, which covers all files
    network : the ONNX file's bytes, None for a geometric-only machine
    """

    path: Path
    version: str
    machine: Machine
    manifest: Manifest
    geometry: ErrorMap
    network: bytes | None


def load_bundle(path: str | Path) -> Bundle:
    """Read a bundle from its folder and verify it.

    Raises
    ------
    InputError
        as `read_files` and `parse_bundle`.
    """
    return parse_bundle(read_files(path), path)


def read_files(path: str | Path) -> dict[str, bytes]:
    """Return the files of a bundle's folder, unverified.

    Raises
    ------
    BundleError
        where there is no such folder, or a file cannot be read.
    """
    path = Path(path)
    if not path.is_dir():
        raise BundleError(f"bundle '{path}' must be a folder with {MACHINE} and {MANIFEST}; there is none")
    files: dict[str, bytes] = {}
    for name, most in MAX_BYTES.items():
        try:
            with (path / name).open("rb") as file:
                size = os.fstat(file.fileno()).st_size  # to ask for far more than there is costs a millisecond
                files[name] = file.read(min(size, most) + 1)
        except FileNotFoundError:
            continue
        except OSError as problem:
            raise BundleError(f"bundle '{path}': {name} cannot be read: {_reason(problem)}") from None
    return files


def parse_bundle(files: Mapping[str, bytes], path: str | Path) -> Bundle:
    """Return the bundle that consists of these files, after verifying digest, checksums and contents.

    Parameters
    ----------
    files : content by name
    path : names the bundle in messages

    Raises
    ------
    BundleError
        where a file is missing, changed, unknown, too large or does not fit the others; it names the file.
    InputError
        where the machine description or the table of geometric errors is wrong.
    """
    path = Path(path)
    where = f"bundle '{path}'"
    _check_names(files, where)
    manifest, digest = _read_manifest(files[MANIFEST], where)
    _check_sums(files, manifest, where)
    machine = _parse_machine(files[MACHINE], path)
    if manifest.machine != machine.name:
        raise BundleError(f"{where}: {MANIFEST} is for machine '{manifest.machine}', {MACHINE} for '{machine.name}'")
    network = files.get(NETWORK)
    if (network is None) != (manifest.network is None):
        raise BundleError(f"{where}: {NETWORK} and the manifest's 'network' must come together; export it again")
    if manifest.network is not None:
        _check_network(manifest.network, machine, f"{where}: {MANIFEST}")
    geometry = _geometry(files.get(GEOMETRY), machine, path / GEOMETRY, f"{where}, {GEOMETRY}")
    if network is not None:
        key = manifest.files[NETWORK]
        network = _networks.get(key, network)
        _keep(_networks, key, network)
    return Bundle(path, digest[:12], machine, manifest, geometry, network)


MOST_SHARED = 64
"""Contents that bundles share, the newest: a hall has many machines of few types."""
_geometries: OrderedDict[Hashable, ErrorMap] = OrderedDict()
_checked: OrderedDict[Hashable, NetworkRecord] = OrderedDict()
_networks: OrderedDict[Hashable, bytes] = OrderedDict()


def _geometry(content: bytes | None, machine: Machine, path: Path, where: str) -> ErrorMap:
    """Return the geometric errors; bundles with the same ones share their arrays, which are most of what they hold."""
    low, high = machine.axis_ends
    terms = tuple((term.name, term.to_internal) for term in machine.terms)
    key = hashlib.sha256(content or b"").digest(), machine.axis_names, low.tobytes(), high.tobytes(), terms
    known = _geometries.get(key)
    if known is None:
        rows = [] if content is None else read_error_table(path, content)
        known = ErrorMap.from_rows(machine, rows, where)
        _keep(_geometries, key, known)
    return replace(known, machine=machine)


def _check_network(record: NetworkRecord, machine: Machine, where: str) -> None:
    """Check a record, as `check_network`, unless this one has been checked for such a machine before."""
    key = id(record), machine.kind
    if _checked.get(key) is not record:
        check_network(record, machine, where)
    _keep(_checked, key, record)


def _keep(contents: OrderedDict[Hashable, Any], key: Hashable, content: Any) -> None:
    contents[key] = content
    contents.move_to_end(key)
    while len(contents) > MOST_SHARED:
        contents.popitem(last=False)


_ROWS = re.compile(r"\[[^\[\]{}\"]*\]")


def sealed(manifest: Mapping[str, Any]) -> bytes:
    """Return `manifest.json` with its digest: the SHA-256 of these bytes with `UNSEALED` in the digest's place."""
    text = json.dumps({**manifest, "digest": UNSEALED}, indent=1, allow_nan=False) + "\n"
    # Rows of numbers stand on one line each: thousands of them would be unreadable otherwise.
    raw = _ROWS.sub(lambda row: " ".join(row.group().split()), text).encode()
    return raw.replace(UNSEALED.encode(), hashlib.sha256(raw).hexdigest().encode())


def version_of(files: Mapping[str, bytes]) -> str | None:
    """Return the version of a bundle's files, None where they are not those that its manifest was sealed with.

    It is quick: contents are not looked at.
    """
    raw = files.get(MANIFEST, b"")
    found = re.search(rb'"digest": "([0-9a-f]{64})"', raw)
    if found is None:
        return None
    digest = found.group(1)
    unsealed = raw.replace(digest, UNSEALED.encode(), 1)
    sums = (hashlib.sha256(content).hexdigest().encode() for name, content in files.items() if name != MANIFEST)
    whole = hashlib.sha256(unsealed).hexdigest().encode() == digest and all(each in raw for each in sums)
    return digest[:12].decode() if whole else None


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
            digest=UNSEALED,
            machine=machine.name,
            files=files,
            network=record,
            training=training,
            test=test,
        )
        (staging / MANIFEST).write_bytes(sealed(manifest.model_dump(mode="json")))
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


def _check_names(files: Mapping[str, bytes], where: str) -> None:
    for name, content in files.items():
        if name not in MAX_BYTES:
            raise BundleError(f"{where} must have only {', '.join(MAX_BYTES)}, got '{name}'; leave it out")
        if len(content) > MAX_BYTES[name]:
            raise BundleError(f"{where}: {name} must have at most {MAX_BYTES[name]} bytes, got more")
    for name in (MANIFEST, MACHINE):
        if name not in files:
            raise BundleError(f"{where}: {name} is missing; export it again")


def _read_manifest(raw: bytes, where: str) -> tuple[Manifest, str]:
    """Return the manifest and its digest."""
    manifest = parsed_manifest(raw, where, MANIFEST)
    digest = manifest.digest.encode()
    unsealed = raw.replace(digest, UNSEALED.encode(), 1)
    if raw.count(digest) != 1 or hashlib.sha256(unsealed).hexdigest() != manifest.digest:
        raise BundleError(f"{where}: {MANIFEST} is not as it was written (its digest differs); export it again")
    return manifest, manifest.digest


def _check_sums(files: Mapping[str, bytes], manifest: Manifest, where: str) -> None:
    known = sorted(MAX_BYTES.keys() - {MANIFEST})
    for name, expected in manifest.files.items():
        if name not in known:
            raise BundleError(f"{where}: {MANIFEST} lists '{name}'; a bundle has only {', '.join(known)}")
        if name not in files:
            raise BundleError(f"{where}: {name} is missing; export it again")
        if hashlib.sha256(files[name]).hexdigest() != expected:
            raise BundleError(f"{where}: {name} does not match {MANIFEST} (sha256 differs); export it again")
    for name in known:
        if name in files and name not in manifest.files:
            raise BundleError(f"{where}: {MANIFEST} has no checksum of {name}; export it again")


def _parse_machine(content: bytes, path: Path) -> Machine:
    where = f"machine description '{path / MACHINE}'"
    try:
        return parse_machine(content.decode("utf-8"), where)
    except UnicodeDecodeError:
        raise MachineError(f"{where} must be UTF-8 text") from None
