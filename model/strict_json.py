"""JSON that means one thing: no key twice, no NaN, nothing that Python reads and others do not."""

from __future__ import annotations

import json
import math
import re
from typing import Any

_MAY_BE_LARGE = re.compile(rb"[eE]\+?[0-9]{3}|[0-9]{200}")
"""An exponent of three digits, or so many digits that one of two is enough."""
_MAY_BE_HALF = re.compile(rb"\\u[dD][89a-fA-F]")
"""A character written as two escapes, of which one may be missing."""


def strict_json(raw: bytes) -> Any:
    """Return what JSON in UTF-8 says.

    Raises
    ------
    ValueError
        where it is not JSON, has a key twice, a number that no double holds, half a character, or is nested too deeply
        to be read.
    """
    # Few have a number that could be too large for a double, and to look at each takes longer than to read it.
    parse_float = _float if _MAY_BE_LARGE.search(raw) else None
    try:
        found = json.loads(
            raw.decode("utf-8"),
            object_pairs_hook=_object,
            parse_constant=_constant,
            parse_float=parse_float,
            parse_int=_int,
        )
        if _MAY_BE_HALF.search(raw):
            _check_characters(found)
        return found
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def _check_characters(found: Any) -> None:
    """Refuse half a surrogate pair, which Python reads and nobody can write as UTF-8."""
    try:
        json.dumps(found, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        raise ValueError("characters must be whole, got half a surrogate pair") from None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"key '{twice}' stands twice")
    return found


def _constant(name: str) -> Any:
    raise ValueError(f"numbers must be finite, got {name}")


def _float(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"numbers must be finite, got {text[:32]}")
    return value


def _int(text: str) -> int:
    if len(text) > 16:  # beyond this a double does not hold every integer
        raise ValueError(f"whole numbers must have at most 16 digits, got {text[:32]}")
    return int(text)
