"""Copies of the demo machine under names of their own, for benchmarks of many machines."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

from model.bundle import load_bundle, sealed

DEMO = Path(__file__).parents[1] / "demo" / "vmc3"
POSITION_OF = {"X": 400.0, "Y": 250.0, "Z": 250.0}


def write_copies(folder: Path, count: int) -> list[Path]:
    """Return bundles of so many machines, all with the same network and geometric errors."""
    source = (DEMO / "machine.toml").read_text(encoding="utf-8")
    manifest = json.loads((DEMO / "manifest.json").read_text(encoding="utf-8"))
    old = manifest["machine"]
    if source.count(f'name = "{old}"') != 1:
        raise SystemExit(f"machine.toml must have one line name = '{old}'")
    paths = []
    for number in range(count):
        name = f"mill-{number:04}"
        path = folder / name
        shutil.copytree(DEMO, path)
        text = source.replace(f'name = "{old}"', f'name = "{name}"')
        (path / "machine.toml").write_text(text, encoding="utf-8")
        files = manifest["files"] | {"machine.toml": hashlib.sha256(text.encode()).hexdigest()}
        (path / "manifest.json").write_bytes(sealed(manifest | {"machine": name, "files": files}))
        paths.append(path)
    load_bundle(paths[-1])
    return paths
