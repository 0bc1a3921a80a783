"""`thermotrue serve`: the HTTP service."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from model.bundle import Bundle


@click.command()
@click.argument("bundles", nargs=-1, type=click.Path(path_type=Path))
@click.option("--host", help="Address to listen on.  [default: 127.0.0.1]")
@click.option("--port", type=int, help="Port to listen on; 0 takes a free one.  [default: 8000]")
@click.option("--allow-remote", is_flag=True, default=None, help="Listen beyond this computer; there are no keys yet.")
@click.option("--stale-after", "stale_after_s", type=float, help="Age from which telemetry is stale [s].")
@click.option("--replay", is_flag=True, default=None, help="Times in requests are the clock: for simulations only.")
@click.option("--access-log", is_flag=True, default=None, help="Log every request.")
@click.option("--log-level", help="debug, info, warning or error.  [default: info]")
def serve(bundles: tuple[Path, ...], **options: Any) -> None:
    """Serve bundles over HTTP: temperatures and positions in, corrected coordinates out.

    Every option can also be given as an environment variable: --port as THERMOTRUE_PORT, the bundles, separated as
    in PATH, as THERMOTRUE_BUNDLES. Options come first.
    """
    import os
    import signal

    from model.exceptions import InputError
    from service.settings import read_settings

    for number in (signal.SIGINT, signal.SIGTERM):
        # Until the server runs there is nothing to wind up. An exception would not do: raised during an import of
        # compiled code it is reported as that import's failure.
        signal.signal(number, lambda *_: os._exit(0))
    given = {name: value for name, value in options.items() if value is not None}
    settings = read_settings(**given, **({"bundles": bundles} if bundles else {}))
    if not settings.bundles:
        raise InputError("name at least one bundle to serve, such as `thermotrue serve demo/vmc3`")

    from model.bundle import load_bundle
    from service.listen import address, check_host, run, take_port

    check_host(settings)
    with take_port(settings) as listener:
        from service.app import create_app
        from service.logs import configure

        loaded = [load_bundle(path) for path in settings.bundles]
        app = create_app(loaded, settings)
        configure(settings.log_level, access=settings.access_log)
        at = address(listener)
        run(app, listener, settings, ready=lambda: click.echo(greeting(loaded, at, replay=settings.replay)))


def greeting(bundles: list[Bundle], address: str, *, replay: bool = False) -> str:
    """Return what is printed once the service answers: the machines, a call to paste, the documentation."""
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
    lines += [
        "try it:",
        f"  curl -s {compensate} -H 'content-type: application/json' -d '{body}'",
        f"all calls: {address}/docs",
    ]
    if replay:
        lines.insert(0, "replay: the times in requests are the clock; not for a real machine")
    return "\n".join(lines)
