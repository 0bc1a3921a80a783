"""`thermotrue settings`: what the service would run with, and where each value comes from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from service.cli_options import setting_options


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@setting_options
def settings(config: Path | None, *, as_json: bool, **options: Any) -> None:
    """Print every setting: its value, where it comes from, and what it means.

    Values come from the options, which are those of `thermotrue serve`, then from the environment (`port` from
    THERMOTRUE_PORT), then from the TOML file that --config or THERMOTRUE_CONFIG names, then by default.
    """
    import json

    from service.settings import unknown_variables
    from service.settings_table import rows, shown

    table = rows(config, **{name: value for name, value in options.items() if value is not None})
    for warning in unknown_variables():
        click.echo(warning, err=True)
    if as_json:
        click.echo(json.dumps([row.as_dict() for row in table], indent=2))
        return
    wide = max(len(row.name) for row in table)
    for row in table:
        click.echo(f"{row.name.ljust(wide)}  {shown(row.value)}  ({row.origin})")
        click.echo(f"{' ' * wide}    {row.meaning}")
