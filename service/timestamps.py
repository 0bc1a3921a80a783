"""Points in time at the edge: RFC 3339 or epoch seconds in, seconds inside, RFC 3339 out."""

from __future__ import annotations

from contextlib import suppress
from datetime import UTC, datetime
from typing import Annotated

from pydantic import BeforeValidator, WithJsonSchema

LATEST_S = 253402300799.0
"""The end of the year 9999, the last that RFC 3339 can write [s]."""
EXAMPLE = "2026-01-31T08:00:00Z"


def parse_time(value: object) -> float:
    """Return epoch seconds of an RFC 3339 string or of a number of seconds.

    Raises
    ------
    ValueError
        with the end of a sentence that starts with the key's name.
    """
    if isinstance(value, str):
        try:
            moment = datetime.fromisoformat(value)
        except ValueError:
            raise ValueError(f"must be RFC 3339, such as {EXAMPLE}, or epoch seconds") from None
        if moment.tzinfo is None:
            raise ValueError(f"must carry its offset from UTC, such as the Z of {EXAMPLE}")
        value = moment.timestamp()
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"must be RFC 3339, such as {EXAMPLE}, or epoch seconds")
    if not 0 <= value <= LATEST_S:  # NaN fails, too
        raise ValueError("must lie between the years 1970 and 9999; give seconds")
    return float(value)


def parse_query_time(value: object) -> float:
    """Return epoch seconds of a time in a query, where numbers come as text, too."""
    if isinstance(value, str):
        with suppress(ValueError):
            value = float(value)
    return parse_time(value)


def format_time(time_s: float) -> str:
    """Return RFC 3339 in UTC, to the microsecond where there are any."""
    return datetime.fromtimestamp(time_s, UTC).isoformat().replace("+00:00", "Z")


_SCHEMA = WithJsonSchema(
    {
        "oneOf": [
            {"type": "string", "format": "date-time"},
            {"type": "number", "minimum": 0, "maximum": LATEST_S},
        ],
        "description": "RFC 3339 with an offset from UTC, or epoch seconds.",
        "examples": [EXAMPLE],
    }
)
Timestamp = Annotated[float, BeforeValidator(parse_time), _SCHEMA]
QueryTimestamp = Annotated[float, BeforeValidator(parse_query_time), _SCHEMA]
