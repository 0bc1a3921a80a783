"""The settings as options: of `thermotrue serve`, and of `thermotrue settings`, which shows what would hold."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])

# One for each setting (`service.settings`, which is not imported here: it takes longer to load than a signal may wait).
_OPTIONS = (
    click.option(
        "--config", type=click.Path(path_type=Path), help="TOML file with settings; options and environment win."
    ),
    click.option("--host", help="Address to listen on.  [default: 127.0.0.1]"),
    click.option("--port", type=int, help="Port to listen on; 0 takes a free one.  [default: 8000]"),
    click.option("--keys", help="auto, required or off: whether callers must show a key.  [default: auto]"),
    click.option("--allow-open", is_flag=True, default=None, help="Let --keys off hold beyond this computer."),
    click.option("--allow-plain-http", is_flag=True, default=None, help="Listen beyond this computer without TLS."),
    click.option("--tls-cert", type=click.Path(path_type=Path), help="Certificate chain, PEM: speak HTTPS."),
    click.option("--tls-key", type=click.Path(path_type=Path), help="The certificate's private key, PEM."),
    click.option("--max-requests-per-s", type=float, help="From one key or address; 0 for no limit.  [default: 2000]"),
    click.option("--max-in-work", type=int, help="Computing requests at a time; more get 503.  [default: 64]"),
    click.option("--max-telemetry-in-work", type=int, help="The same for telemetry.  [default: 1024]"),
    click.option("--stale-after", "stale_after_s", type=float, help="Age from which telemetry is stale [s]."),
    click.option("--stale-fade", "stale_fade_s", type=float, help="How long its part then takes to be gone [s]."),
    click.option("--data-dir", type=click.Path(path_type=Path), help="Folder of the database."),
    click.option(
        "--database", metavar="URL", help="sqlite:///FILE, postgresql://USER@HOST/NAME, or sqlite:// for memory."
    ),
    click.option("--telemetry-keep-days", type=float, help="How long telemetry is kept [days].  [default: 30]"),
    click.option("--snapshot-every", "snapshot_every_s", type=float, help="Between stored thermal states [s]."),
    click.option("--replay", is_flag=True, default=None, help="Times in requests are the clock: for simulations only."),
    click.option("--access-log", is_flag=True, default=None, help="Log every request."),
    click.option("--log-level", help="debug, info, warning or error.  [default: info]"),
)


def setting_options(command: Command) -> Command:
    """Add an option for each setting; one that is not given is None."""
    for add in reversed(_OPTIONS):
        command = add(command)
    return command
