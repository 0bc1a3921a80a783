"""Settings: one record, from the command line, the environment and a file, in this order of precedence."""

from __future__ import annotations

import ipaddress
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, field_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from model.exceptions import InputError
from model.validation import did_you_mean, sentence

PREFIX = "THERMOTRUE_"
"""What the environment variables of settings start with."""
CONFIG = f"{PREFIX}CONFIG"
"""The environment variable that names the file; the only place besides `--config`."""


def default_data_dir() -> Path:
    """Return where programs of a user keep what they must not lose."""
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "thermotrue"


class Settings(BaseSettings):
    """How the service runs; each setting's description says what it means, and `thermotrue settings` prints them."""

    model_config = SettingsConfigDict(env_prefix=PREFIX, frozen=True, extra="forbid", allow_inf_nan=False)

    bundles: Annotated[tuple[Path, ...], NoDecode] = Field(
        (), description="Folders to serve; in the environment separated as in PATH."
    )
    host: str = Field("127.0.0.1", description="Address to listen on.")
    port: int = Field(8000, ge=0, le=65535, description="Port to listen on; 0 takes a free one.")
    keys: Literal["auto", "required", "off"] = Field(
        "auto",
        description="Whether callers must show a key. `auto`: yes, unless the host is a loopback address and no key "
        "was ever made.",
    )
    allow_open: bool = Field(False, description="Let `keys = off` hold beyond loopback, where anybody can then steer.")
    allow_plain_http: bool = Field(
        False, description="Listen beyond loopback without TLS: behind a proxy that has it, or in a container."
    )
    tls_cert: Path | None = Field(None, description="Certificate chain, PEM; with it the service speaks HTTPS alone.")
    tls_key: Path | None = Field(None, description="The certificate's private key, PEM, not encrypted.")
    max_requests_per_s: float = Field(
        2000.0, ge=0, description="From one key, or from one address where keys are off; 0 for no such limit [1/s]."
    )
    max_in_work: int = Field(
        64, ge=1, description="Requests at a time that compute something; more are answered with 503, not kept waiting."
    )
    max_telemetry_in_work: int = Field(
        1024, ge=1, description="The same for telemetry, datum and measurements, which go first."
    )
    stale_after_s: float = Field(
        600.0, gt=0, description="Age of the newest telemetry from which the thermal part fades [s]."
    )
    stale_fade_s: float = Field(1800.0, gt=0, description="How long it then takes to be gone [s].")
    replay: bool = Field(
        False,
        description="Times in requests are the clock, for simulations and demonstrations. Never on a real machine: a "
        "wrong time in a request then moves the rate limit and the age of telemetry.",
    )
    data_dir: Path = Field(
        default_factory=default_data_dir, description="Folder of the database, made where it is missing."
    )
    database: str | None = Field(
        None,
        description="Where telemetry, thermal states, models, keys and the audit trail are kept: sqlite:///FILE, "
        "postgresql://USER@HOST/NAME, or sqlite:// for memory. Default: thermotrue.db in the data folder; with "
        "`replay` memory, since a simulated clock must not outlive its process.",
    )
    telemetry_keep_days: float = Field(30.0, gt=0, description="How long telemetry is kept [days].")
    snapshot_every_s: float = Field(
        30.0, gt=0, description="How often a thermal state is stored while telemetry comes; the rest is replayed [s]."
    )
    access_log: bool = Field(False, description="Log every request.")
    log_level: Literal["debug", "info", "warning", "error"] = Field("info", description="The least to log.")

    @field_validator("bundles", mode="before")
    @classmethod
    def _split(cls, value: Any) -> Any:
        return tuple(filter(None, value.split(os.pathsep))) if isinstance(value, str) else value

    @property
    def database_url(self) -> str:
        """The database in use; it may hold a password, so it is not for messages."""
        if self.database is not None:
            return self.database
        return "sqlite://" if self.replay else f"sqlite:///{self.data_dir.absolute() / 'thermotrue.db'}"


@dataclass(frozen=True)
class Origin:
    """Where a setting's value came from.

    Attributes
    ----------
    kind : 'default', 'file', 'environment' or 'option'
    place : the file, the variable or the option, as a message should name it
    """

    kind: Literal["default", "file", "environment", "option"]
    place: str


def read_settings(config: Path | None = None, /, **given: Any) -> Settings:
    """Return the settings.

    Parameters
    ----------
    config : a TOML file with settings; the environment variable THERMOTRUE_CONFIG names another where this is None
    given : values from the command line, which come first

    Raises
    ------
    InputError
        with one sentence that names the setting, where it came from, the value and what would be right.
    """
    path, from_file = _read_file(config)
    origins = _origins(path, from_file, given)
    try:
        return Settings(**{k: v for k, v in from_file.items() if origins[k].kind == "file"} | given)
    except ValidationError as problem:
        [first, *_] = problem.errors()
        at = origins.get(str(first["loc"][0])) if first["loc"] else None
        where = "the settings" if at is None else f"the settings ({at.place})"
        raise InputError(sentence([first], Settings, where)) from None


def origins(config: Path | None = None, /, **given: Any) -> dict[str, Origin]:
    """Return where the value of each setting comes from; parameters and exceptions are those of `read_settings`."""
    return _origins(*_read_file(config), given)


def is_loopback(host: str) -> bool:
    """Return whether only this computer can reach what listens there; names besides localhost may lead anywhere."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def option(name: str) -> str:
    """Return a setting's option; a duration's has no unit."""
    short = name if name.endswith("_per_s") else name.removesuffix("_s")
    return f"--{short.replace('_', '-')}"


def unknown_variables(environment: Mapping[str, str] | None = None) -> list[str]:
    """Return a sentence for each environment variable that looks like a setting and is none.

    It is no error: container engines put variables of this form into the environment, too.
    """
    known = {f"{PREFIX}{name.upper()}" for name in Settings.model_fields} | {CONFIG}
    others = ("DEBUG", "TEST_")  # of the console script, and of the tests
    found = sorted(name for name in environment or os.environ if name.upper().startswith(PREFIX))
    return [
        f"unknown environment variable '{name}'; it is not used{did_you_mean(name.upper(), sorted(known))}"
        for name in found
        if name.upper() not in known and not name.upper().removeprefix(PREFIX).startswith(others)
    ]


def _read_file(config: Path | None) -> tuple[Path | None, dict[str, Any]]:
    path = config or (Path(os.environ[CONFIG]) if os.environ.get(CONFIG) else None)
    if path is None:
        return None, {}
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise InputError(f"settings file '{path}' must be readable: {(problem.strerror or '').lower()}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise InputError(f"settings file '{path}' must be TOML: {problem}") from None
    for key in content:
        if key not in Settings.model_fields:
            hint = did_you_mean(key, list(Settings.model_fields))
            raise InputError(f"unknown key '{key}' in settings file '{path}'{hint}")
    return path, content


def _origins(path: Path | None, from_file: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Origin]:
    variables = {name.upper(): name for name in os.environ}
    found = {}
    for name in Settings.model_fields:
        variable = f"{PREFIX}{name.upper()}"
        if name in given:
            found[name] = Origin("option", f"option {option(name)}")
        elif variable in variables:
            found[name] = Origin("environment", f"environment variable {variables[variable]}")
        elif name in from_file:
            found[name] = Origin("file", f"file '{path}'")
        else:
            found[name] = Origin("default", "default")
    return found
