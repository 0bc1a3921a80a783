"""The files of an uploaded bundle, out of a ZIP archive that may be anything."""

from __future__ import annotations

import io
import zipfile
import zlib

from model.bundle import MAX_BYTES
from model.exceptions import BundleError

ENCRYPTED = 0x1
"""The bit of an entry's flags."""
UNREADABLE = (zipfile.BadZipFile, zlib.error, EOFError, ValueError, NotImplementedError, RuntimeError, OSError)
"""What the standard library raises for archives that are none."""
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def unpack(body: bytes) -> dict[str, bytes]:
    """Return the files of a bundle by name. Nothing is written anywhere.

    Raises
    ------
    BundleError
        where it is not a ZIP archive of a bundle's files and nothing else, each once, not encrypted, none in a folder
        and none larger than such a file may be, whatever the archive says of its size.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(body)) as archive:
            entries = archive.infolist()
            _check(entries)
            return {entry.filename: _read(archive, entry) for entry in entries}
    except BundleError:
        raise
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        ValueError,
        NotImplementedError,
        RuntimeError,
        OSError,
    ) as problem:
        reason = str(problem) or type(problem).__name__
        raise BundleError(f"the body must be a ZIP archive of a bundle's files, and cannot be read: {reason}") from None


def _check(entries: list[zipfile.ZipInfo]) -> None:
    known = ", ".join(MAX_BYTES)
    if not entries:
        raise BundleError(f"the archive must have the files {known}, got none")
    seen: set[str] = set()
    for entry in entries:
        name = entry.filename
        if name not in MAX_BYTES or name != entry.orig_filename:
            raise BundleError(f"the archive must have only the files {known}, and no folders, got '{name[:64]}'")
        if name in seen:
            raise BundleError(f"the archive must have {name} once, got it twice")
        seen.add(name)
        if entry.flag_bits & ENCRYPTED or entry.compress_type not in METHODS:
            what = "encrypted" if entry.flag_bits & ENCRYPTED else f"packed by method {entry.compress_type}"
            raise BundleError(f"{name} in the archive must be stored or deflated, got it {what}")
        _check_size(name, entry.file_size)


def _read(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bytes:
    with archive.open(entry) as file:
        content = file.read(MAX_BYTES[entry.filename] + 1)
    _check_size(entry.filename, len(content))
    return content


def _check_size(name: str, size: int) -> None:
    if size > MAX_BYTES[name]:
        raise BundleError(f"{name} in the archive must have at most {MAX_BYTES[name]} bytes, got {size}")
