"""Numbers, times and names as people read them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

MINUS = "\N{MINUS SIGN}"
NEAR = "\N{NO-BREAK SPACE}"
"""Between a number and its unit, so that no line ends there."""


def number(value: float, digits: int = 3) -> str:
    """Return a number with so many significant digits and no exponent: 0.0123, 1.20, −45.6, 12345."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    text = f"{value:.{min(max(digits - 1 - size, 0), 9)}f}"
    return MINUS + text[1:] if text.startswith("-") else text


def plain(value: float) -> str:
    """Return a number as short as it was given: 12000, 0.5."""
    text = f"{value:.10g}"
    return MINUS + text[1:] if text.startswith("-") else text


def micrometres(value: float, unit: str = "µm") -> str:
    """Return a length or an angle: "6.25 µm" from 6.25; the second decimal is the last that means anything."""
    if abs(value) < 0.005:
        return f"0{NEAR}{unit}"
    return f"{number(value) if abs(value) >= 1.0 else f'{value:.2f}'.replace('-', MINUS)}{NEAR}{unit}"


def percent(share: float, decimals: int = 1) -> str:
    """Return a share: "11.1 %"."""
    return f"{100.0 * share:.{decimals}f}{NEAR}%"


def duration(seconds: float) -> str:
    """Return a time: "8.0 s", "2 min", "1.5 h", "3.2 days"."""
    for limit, unit, word in ((60.0, 1.0, "s"), (3600.0, 60.0, "min"), (48 * 3600.0, 3600.0, "h")):
        if seconds < limit:
            value = seconds / unit
            return f"{value:.2g}{NEAR}{word}" if value < 9.95 else f"{value:.0f}{NEAR}{word}"
    return f"{seconds / 86400.0:.1f}{NEAR}days"


def clock(seconds: float) -> str:
    """Return a moment of a run as hours and minutes since power-on: "5 h 04 min"."""
    minutes = round(seconds / 60.0)
    return f"{minutes // 60}{NEAR}h {minutes % 60:02d}{NEAR}min"


CHANNEL_UNITS = {"_rpm": "rpm", "_kw": "kW", "_l_min": "l/min", "_mm_min": "mm/min"}
"""Endings of a channel's name that say its unit."""


def channel_value(name: str, value: float) -> str:
    """Return a channel's value, with its unit where the name ends in one; telemetry does not state it otherwise."""
    for ending, unit in CHANNEL_UNITS.items():
        if name.lower().endswith(ending):
            return f"{_short(value)}{NEAR}{unit}"
    return _short(value)


def _short(value: float) -> str:
    return plain(value if value == round(value) else float(f"{value:.3g}"))


def flat(settings: Mapping[str, object], prefix: str = "") -> list[tuple[str, str]]:
    """Return nested settings as names and values: `prior.powers`, "0.5, 1, 1.5, 2"."""
    rows: list[tuple[str, str]] = []
    for name, value in settings.items():
        if isinstance(value, Mapping):
            rows += flat(value, f"{prefix}{name}.")
        elif isinstance(value, Sequence) and not isinstance(value, str):
            rows.append((prefix + name, ", ".join(_text(v) for v in value) or "none"))
        else:
            rows.append((prefix + name, _text(value)))
    return rows


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return "none"
    return plain(value) if isinstance(value, int | float) else str(value)
