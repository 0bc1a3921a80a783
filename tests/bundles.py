"""Bundles that are changed as an exporter would have written them: with checksums and digest that fit."""

import hashlib
import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from model.bundle import MANIFEST, sealed


def edit(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change the manifest of a bundle's folder."""
    manifest = json.loads((path / MANIFEST).read_text())
    change(manifest)
    (path / MANIFEST).write_bytes(sealed(manifest))


def resealed(files: dict[str, bytes], change: Callable[[dict[str, Any]], object] = lambda _: None) -> dict[str, bytes]:
    """Return a bundle's files with the manifest changed, and checksums and digest computed anew."""
    manifest = json.loads(files[MANIFEST])
    manifest["files"] = {n: hashlib.sha256(c).hexdigest() for n, c in sorted(files.items()) if n != MANIFEST}
    change(manifest)
    return {**files, MANIFEST: sealed(manifest)}


def packed(files: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    """Return a ZIP archive of a bundle's files, as it is uploaded."""
    body = io.BytesIO()
    with zipfile.ZipFile(body, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return body.getvalue()
