"""The settings as a table: for `thermotrue settings`, and for the documentation's test."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from service.settings import Settings, origins, read_settings

_PASSWORD = re.compile(r"(?<=://)([^/@:]*):.*(?=@)|(?<=password=)[^&]*", re.IGNORECASE)


@dataclass(frozen=True)
class Row:
    """One setting.

    Attributes
    ----------
    value : as it would stand in the file, a password hidden
    origin : 'default', or the file, variable or option
    """

    name: str
    value: Any
    origin: str
    meaning: str

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return asdict(self)


def rows(config: Path | None = None, /, **given: Any) -> list[Row]:
    """Return all settings as they hold; parameters and exceptions are those of `read_settings`."""
    values = read_settings(config, **given).model_dump(mode="json")
    found = origins(config, **given)
    return [
        Row(name, hidden(values[name]), found[name].place, field.description or "")
        for name, field in Settings.model_fields.items()
    ]


def hidden(value: Any) -> Any:
    """Return a value with the password in it hidden, where it is a URL that has one."""
    if not isinstance(value, str):
        return value
    return _PASSWORD.sub(lambda found: f"{found[1]}:***" if found[1] is not None else "***", value)


def shown(value: Any) -> str:
    """Return a value as it would stand in the settings file; one that has none is '-'."""
    return "-" if value is None else json.dumps(value, ensure_ascii=False)
