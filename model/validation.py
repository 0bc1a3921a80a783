"""Check parsed files against pydantic schemas, and say what is wrong in one sentence."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from model.exceptions import InputError


class Strict(BaseModel):
    """A record that refuses keys it does not know, NaN and infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Record = TypeVar("Record", bound=BaseModel)


def check(schema: type[Record], data: Mapping[str, Any], where: str, error: type[InputError]) -> Record:
    """Return `data` as a `schema` record.

    Parameters
    ----------
    schema : the record's class
    data : what a parser returned
    where : what is being read, as the message should name it ("machine description 'vmc3.toml'")
    error : the exception to raise

    Raises
    ------
    InputError
        (as `error`) with one sentence that names the key, the value and what would be right.
    """
    try:
        return schema.model_validate(data)
    except ValidationError as problem:
        raise error(sentence(problem.errors(), schema, where)) from None


def sentence(findings: Sequence[Mapping[str, Any]], schema: type[BaseModel], where: str) -> str:
    """Turn the first of pydantic's findings (`ValidationError.errors()`) into one sentence."""
    # A misspelt key also shows up as a missing one; the misspelling is the more useful thing to say.
    first = min(findings, key=lambda e: e["type"] != "extra_forbidden")
    path = [str(part) for part in first["loc"]]
    if first["type"] == "extra_forbidden":
        return f"unknown key '{'.'.join(path)}' in {where}{did_you_mean(path[-1], _keys(schema, path))}"
    if first["type"] == "missing":
        return f"key '{'.'.join(path)}' is missing in {where}"
    if not path and first["type"] in ("model_type", "dict_type"):
        return f"{where} must be an object with keys, got {first['input']!r}"
    reason = first["msg"].removeprefix("Value error, ")
    reason = reason[:1].lower() + reason[1:]
    place = f"key '{'.'.join(path)}' in {where}" if path else where
    return f"{place}: {reason}, got {first['input']!r}"


def did_you_mean(word: str, known: list[str]) -> str:
    """Return "; did you mean 'x'?" for the nearest known word, or the list of known words."""
    near = difflib.get_close_matches(word, known, n=1)
    if near:
        return f"; did you mean '{near[0]}'?"
    return f"; known are {', '.join(sorted(known))}" if known else ""


def _keys(schema: type[BaseModel], path: list[str]) -> list[str]:
    """List the keys allowed where `path` ends, following nested records and tables of records."""
    known: Any = schema
    for part in path[:-1]:
        if isinstance(known, type) and issubclass(known, BaseModel) and part in known.model_fields:
            known = known.model_fields[part].annotation
        else:
            inner = [a for a in getattr(known, "__args__", ()) if a is not type(None)]
            known = inner[-1] if inner else None
    while known is not None and not (isinstance(known, type) and issubclass(known, BaseModel)):
        inner = [a for a in getattr(known, "__args__", ()) if a is not type(None)]
        known = inner[-1] if inner else None
    return [] if known is None else [f.alias or name for name, f in known.model_fields.items()]
