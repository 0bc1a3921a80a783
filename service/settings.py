"""Settings: one record, from environment variables with the prefix `THERMOTRUE_` and from the command line."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, field_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from model.exceptions import InputError
from model.validation import sentence


class Settings(BaseSettings):
    """How the service runs.

    Attributes
    ----------
    bundles : folders to serve; in the environment separated as in PATH
    host, port : where to listen; port 0 takes a free one
    allow_remote : listen beyond loopback
    stale_after_s : age of the newest telemetry from which the thermal part fades [s]
    stale_fade_s : how long it then takes to be gone [s]
    replay : let the times in requests be the clock, for simulations and demonstrations; never on a real machine,
        since then a wrong time in a request moves the rate limit and the age of telemetry
    access_log : one line for every request
    log_level : the least serious events to log
    """

    model_config = SettingsConfigDict(env_prefix="THERMOTRUE_", frozen=True, extra="forbid", allow_inf_nan=False)

    bundles: Annotated[tuple[Path, ...], NoDecode] = ()
    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8000
    allow_remote: bool = False
    stale_after_s: Annotated[float, Field(gt=0)] = 600.0
    stale_fade_s: Annotated[float, Field(gt=0)] = 1800.0
    replay: bool = False
    access_log: bool = False
    log_level: Literal["debug", "info", "warning", "error"] = "info"

    @field_validator("bundles", mode="before")
    @classmethod
    def _split(cls, value: Any) -> Any:
        return tuple(filter(None, value.split(os.pathsep))) if isinstance(value, str) else value


def read_settings(**given: Any) -> Settings:
    """Return the settings; values given override the environment.

    Raises
    ------
    InputError
        with one sentence that names the setting, the value and what would be right.
    """
    try:
        return Settings(**given)
    except ValidationError as problem:
        where = "the settings (an option, or an environment variable with the prefix THERMOTRUE_)"
        raise InputError(sentence(problem.errors(), Settings, where)) from None
