"""Read the text of a manifest: checked against its schema, and what many bundles have in common parsed once.

A hall has many machines of few types, whose manifests differ in their first lines and have half a megabyte in common.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

from model.exceptions import BundleError
from model.manifest import FORMAT_VERSION, Manifest
from model.strict_json import strict_json
from model.validation import check

SPLIT = b'\n "network": '
"""Where what manifests have in common begins, as `sealed` writes it. In JSON no text holds the end of a line, so it
stands nowhere but before a key."""
STUB = SPLIT + b"null}"
MOST_KEPT = 32
"""Second parts of manifests that are kept, the newest; each may take megabytes."""
_kept: OrderedDict[bytes, Mapping[str, Any]] = OrderedDict()


def parsed_manifest(raw: bytes, where: str, name: str) -> Manifest:
    """Return what a manifest says; its digest is not looked at. Equal records of networks are one object.

    Parameters
    ----------
    where, name : of the bundle and of the file, for messages

    Raises
    ------
    BundleError
        where it is not JSON, of another format version, or not as the schema says.
    """
    head, _, tail = raw.partition(SPLIT)
    first = _first(head) if tail else None
    key = b"" if first is None else hashlib.sha256(tail).digest()
    second = None if first is None else _kept.get(key)
    if first is not None and second is not None and not first.keys() & second.keys():
        return _checked({**first, **second}, where, name)
    manifest = _checked(_whole(raw, where, name), where, name)
    if first is not None and manifest.network is not None:
        _kept[key] = {k: getattr(manifest, k) for k in manifest.model_fields_set - first.keys()}
        if len(_kept) > MOST_KEPT:
            _kept.popitem(last=False)
    return manifest


def _first(head: bytes) -> dict[str, Any] | None:
    """Return the keys before the split; None where those after it would not be on the same level."""
    try:
        data = strict_json(head + STUB)
    except ValueError:
        return None
    if not isinstance(data, dict) or "network" not in data:
        return None
    del data["network"]
    return data


def _whole(raw: bytes, where: str, name: str) -> Any:
    try:
        return strict_json(raw)
    except ValueError as problem:
        raise BundleError(f"{where}: {name} is not JSON: {problem}") from None


def _checked(data: Any, where: str, name: str) -> Manifest:
    if not isinstance(data, dict):
        raise BundleError(f"{where}: {name} must be an object, got {_kind(data)}; export it again")
    if data.get("format_version") != FORMAT_VERSION:
        raise BundleError(
            f"{where} has format version {data.get('format_version')!r}, this release reads {FORMAT_VERSION}; "
            "export it again with `thermotrue train`"
        )
    return check(Manifest, data, f"{where}, {name}", BundleError)


def _kind(data: Any) -> str:
    kinds = {list: "a list", str: "a text", bool: "true or false", int: "a number", float: "a number"}
    return kinds.get(type(data), "nothing")
