"""The console script `thermotrue`.

Each package registers its commands as entry points (pyproject.toml), and one is imported when it is called. So
`thermotrue serve` starts without torch, and this package imports none of the others.
"""

from __future__ import annotations

import os
import sys
from importlib.metadata import EntryPoint, entry_points, version

import click

from model.exceptions import InputError, ThermotrueError

ORDER = (
    "describe",
    "budget",
    "identify",
    "deviation",
    "compensate",
    "synth",
    "sensors",
    "train",
    "evaluate",
    "predict",
    "serve",
)
"""Commands in the order in which a user meets them."""


class LazyCommands(click.Group):
    """A group whose commands are loaded when they are called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands."""
        known = _registered()
        return [n for n in ORDER if n in known] + sorted(n for n in known if n not in ORDER)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command."""
        entry = _registered().get(cmd_name)
        if entry is None:
            return None
        command = entry.load()
        assert isinstance(command, click.Command)
        return command


def _registered() -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group="thermotrue.commands")}


@click.group(cls=LazyCommands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(version("thermotrue"), message="thermotrue %(version)s")
def thermotrue() -> None:
    """Predict how a CNC machine tool drifts as it warms up, and command coordinates that make up for it."""


def main() -> None:
    """Run the command line: errors go to stderr in one line, exit code 2 for the user's mistakes, 1 for ours."""
    try:
        sys.exit(thermotrue.main(standalone_mode=False))
    except click.exceptions.Exit as stop:
        sys.exit(stop.exit_code)
    except click.ClickException as problem:
        hint = ""
        if isinstance(problem, click.UsageError) and problem.ctx is not None:
            hint = f"; see `{problem.ctx.command_path} --help`"
        _fail(problem.format_message().rstrip(".") + hint, 2)
    except (click.Abort, KeyboardInterrupt) as stop:
        _fail(str(stop) or "interrupted", 130)
    except InputError as problem:
        _fail(str(problem), 2)
    except ModuleNotFoundError as problem:
        _fail(f"this command needs '{problem.name}'; install it with `pip install 'thermotrue[train]'`", 2)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except Exception as problem:
        if os.environ.get("THERMOTRUE_DEBUG"):
            raise
        kind = "" if isinstance(problem, ThermotrueError) else f"{type(problem).__name__}: "
        _fail(f"{kind}{problem} (set THERMOTRUE_DEBUG=1 for a traceback)", 1)


def _fail(message: str, code: int) -> None:
    print(f"thermotrue: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(code)
