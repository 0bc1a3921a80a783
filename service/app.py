"""The application: bundles in, a FastAPI app out."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from importlib.metadata import version
from typing import Any

from fastapi import FastAPI
from starlette.types import ASGIApp

from model.bundle import Bundle
from model.exceptions import InputError
from service import docs, page, problems
from service.access.install import install as install_access
from service.access.install import refreshed
from service.fast_lane import FastLane
from service.keeper import kept
from service.machine_state import MachineState
from service.measurements import rows
from service.metrics import Metrics, RequestMetrics
from service.models.shelf import Shelf
from service.models.start import begin
from service.openapi import described
from service.recorder import Recorder
from service.request_id import RequestIds
from service.restore import restore
from service.routes import audit as audit_route
from service.routes import (
    compensate,
    datum,
    error_map,
    errors,
    health,
    machines,
    measurements,
    metrics,
    models,
    stream,
    telemetry,
)
from service.security_headers import SecurityHeaders
from service.settings import Settings
from service.store import audit
from service.store.journal import DURABLE_S
from service.store.store import Store, open_store
from service.store.unavailable import StorageUnavailable
from service.stream.places import MAX_BULK, Places
from service.stream.streams import Streams

log = logging.getLogger(__name__)

STORED_WITHIN_S = 30.0
"""How long a start waits until the bundles of its command line are known to the database [s]: a millisecond each."""
FILES_WITHIN_S = 1.0
"""How long it waits for their files, which take ten times as long, once [s]: those of many machines follow later."""

DESCRIPTION = """\
Every error is an RFC 9457 problem. Every answer carries an `X-Request-ID`: the client's, where it sent one of up to 128
letters, digits and `._:/+=@-`, or one made here. Problems and log lines name it, too.
"""


class _App(FastAPI):
    """FastAPI inside the middleware that concerns every answer, that to an exception nobody expected included.

    The framework puts its own handling of those outside of all middleware that is added to it.
    """

    def build_middleware_stack(self) -> ASGIApp:
        counted = RequestMetrics(super().build_middleware_stack(), self.state.metrics)
        return RequestIds(SecurityHeaders(counted))

    def openapi(self) -> dict[str, Any]:
        """Return the description, with what it says of keys as it is now."""
        return described(self, super().openapi(), required=self.state.key_ring.required)


def create_app(
    bundles: Sequence[Bundle],
    settings: Settings,
    clock: Callable[[], float] = time.time,
    steady: Callable[[], float] = time.monotonic,
    store: Store | None = None,
) -> FastAPI:
    """Return the app that serves these bundles; it is ready once it has started.

    Parameters
    ----------
    clock : epoch seconds
    steady : seconds that never jump, for the rate limit
    store : what survives; None opens the database of the settings, and closes it when the app ends

    Raises
    ------
    InputError
        where two bundles are of the same machine, a bundle's network cannot be loaded, or the database cannot be
        used.
    """
    _check_names(bundles)
    opened = open_store(settings.database_url) if store is None else store
    try:
        start = begin(opened, bundles, lambda bundle: MachineState(bundle, settings, clock, steady))
    except InputError:
        if store is None:
            opened.close()
        raise
    states = start.states

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        await asyncio.to_thread(_restore, states, opened)
        for name, state in states.items():
            state.recorder = Recorder(name, opened, settings.snapshot_every_s)
        app.state.machines = states
        opened.journal.write(audit.record("service", "service started", None, {"machines": sorted(states)}))
        for operation in start.operations:
            opened.journal.add(operation)
        with suppress(StorageUnavailable):  # before telemetry comes, which would have to wait for it; /readyz tells
            await opened.journal.durable(STORED_WITHIN_S)
        storing = asyncio.create_task(start.store(opened.journal))  # what is left of it is stored at the next start
        await asyncio.wait([storing], timeout=FILES_WITHIN_S)
        log.info("serving", extra={"machines": sorted(states), "database": opened.name, "new": opened.new})
        async with refreshed(app.state.key_ring), kept(states, opened, settings, clock):
            yield
        storing.cancel()
        with suppress(asyncio.CancelledError):
            await storing
        app.state.machines = None
        opened.journal.write(audit.record("service", "service stopped", None))
        if store is None:
            await asyncio.to_thread(opened.close)
        else:
            with suppress(StorageUnavailable):  # its owner closes it, and is told then
                await opened.journal.durable(DURABLE_S)

    app = _App(
        title="thermotrue",
        telemetry={"tracing": False, "metrics": False, "logs": False},  # /metrics has them, for less
        summary="Thermal and volumetric error compensation for machine tools.",
        description=DESCRIPTION,
        version=version("thermotrue"),
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        generate_unique_id_function=lambda route: route.name,  # what generated clients name their functions by
        responses=problems.RESPONSES,
    )
    app.state.metrics = Metrics()
    app.state.streams = Streams()
    app.state.bulk = Places(MAX_BULK, "Arrow streams")
    app.state.store = opened
    app.state.metrics.watch(opened.journal)
    app.state.shelf = Shelf(opened, start.installed)
    app.state.bundles = [state.bundle for state in states.values()]
    problems.install(app)
    app.add_middleware(FastLane, route=compensate.install(app))
    install_access(app, opened, settings)
    docs.install(app)
    page.install(app)
    for module in (
        stream,
        telemetry,
        health,
        metrics,
        machines,
        errors,
        error_map,
        datum,
        measurements,
        models,
        audit_route,
    ):
        app.include_router(module.router)
    return app


def _restore(states: Mapping[str, MachineState], store: Store) -> None:
    """Bring machines back to where they were; in a thread."""
    for state in states.values():
        restore(state, store.engine)
        rows.load_into(state, store.engine)


def _check_names(bundles: Sequence[Bundle]) -> None:
    """Refuse two bundles of one machine."""
    seen: dict[str, Bundle] = {}
    for bundle in bundles:
        name = bundle.machine.name
        if name in seen:
            raise InputError(
                f"machine '{name}' must be served from one bundle, got '{seen[name].path}' and '{bundle.path}'; "
                "leave one out"
            )
        seen[name] = bundle
