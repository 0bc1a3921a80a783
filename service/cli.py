"""`thermotrue serve`: the HTTP service."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from service.cli_options import setting_options

if TYPE_CHECKING:
    from model.bundle import Bundle


@click.command()
@click.argument("bundles", nargs=-1, type=click.Path(path_type=Path))
@setting_options
def serve(bundles: tuple[Path, ...], config: Path | None, **options: Any) -> None:
    """Serve bundles over HTTP: temperatures and positions in, corrected coordinates out.

    Every option can also be given as an environment variable: --port as THERMOTRUE_PORT, the bundles, separated as
    in PATH, as THERMOTRUE_BUNDLES; or in a TOML file. Options come first, then the environment; `thermotrue settings`
    shows what holds.
    """
    import gc
    import logging
    import os
    import signal

    from model.exceptions import InputError
    from service.settings import is_loopback, read_settings, unknown_variables

    for number in (signal.SIGINT, signal.SIGTERM):
        # Until the server runs there is nothing to wind up. An exception would not do: raised during an import of
        # compiled code it is reported as that import's failure.
        signal.signal(number, lambda *_: os._exit(0))
    given = {name: value for name, value in options.items() if value is not None}
    settings = read_settings(config, **given, **({"bundles": bundles} if bundles else {}))
    if not settings.bundles:
        raise InputError("name at least one bundle to serve, such as `thermotrue serve demo/vmc3`")

    from model.bundle import load_bundle
    from service.listen import address, check_host, run, take_port

    check_host(settings)
    with take_port(settings) as listener:
        from service.app import create_app
        from service.logs import configure
        from service.self_test import check_compiled_path

        loaded = [load_bundle(path) for path in settings.bundles]
        check_compiled_path()
        app = create_app(loaded, settings)
        configure(settings.log_level, access=settings.access_log)
        for warning in unknown_variables():
            logging.getLogger("service").warning(warning)
        required = app.state.key_ring.required
        at = address(listener, settings)
        text = greeting(
            app.state.bundles,
            at,
            replay=settings.replay,
            make_key=_make_key(config, options) if required else None,
            open_to_all=not required and not is_loopback(settings.host),
        )

        def ready() -> None:
            gc.collect()
            gc.freeze()  # what is there now stays, and need not be looked through again and again
            click.echo(text)

        run(app, listener, settings, ready=ready)


def _make_key(config: Path | None, options: dict[str, Any]) -> str:
    """Return the command that makes a key for this service: with the options that say where its database is."""
    from shlex import quote

    from service.settings_table import hidden

    where = {"--config": config, "--data-dir": options["data_dir"], "--database": options["database"]}
    given = [f" {option} {quote(str(hidden(str(value))))}" for option, value in where.items() if value is not None]
    return f"thermotrue keys create my-gateway --role gateway{''.join(given)}"


def greeting(
    bundles: list[Bundle],
    address: str,
    *,
    replay: bool = False,
    make_key: str | None = None,
    open_to_all: bool = False,
) -> str:
    """Return what is printed once the service answers: the machines, a call to paste, the documentation.

    Parameters
    ----------
    make_key : the command for it, where callers must show one
    open_to_all : whoever reaches the address is let in
    """
    import json

    lines = []
    for bundle in bundles:
        machine = bundle.machine
        network = bundle.manifest.network
        reads = f"{len(network.sensors)} sensors" if network is not None else "geometric errors only"
        lines.append(
            f"machine '{machine.name}' from {bundle.path}: model {bundle.version}, axes "
            f"{' '.join(machine.axis_names)}, {reads}"
        )
    machine = bundles[0].machine
    middle = {a: (machine.axes[a].low + machine.axes[a].high) / 2 for a in machine.axis_names}
    body = json.dumps({"positions": [middle]})
    compensate = f"{address}/v1/machines/{machine.name}/compensate"
    shown = "" if make_key is None else ' -H "authorization: Bearer $KEY"'
    if make_key is not None:
        lines += ["callers must show a key; make one:", f"  KEY=$({make_key})"]
    lines += [
        "try it:",
        f"  curl -s {compensate}{shown} -H 'content-type: application/json' -d '{body}'",
        f"what it does now: {address}/",
        f"all calls: {address}/docs",
    ]
    if open_to_all:
        lines.insert(0, "keys are off: whoever reaches this address can steer the correction")
    if replay:
        lines.insert(0, "replay: the times in requests are the clock; not for a real machine")
    return "\n".join(lines)
