"""The application: bundles in, a FastAPI app out."""

from __future__ import annotations

import logging
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from importlib.metadata import version

from fastapi import FastAPI
from starlette.types import ASGIApp

from model.bundle import Bundle
from model.exceptions import InputError
from service import docs, problems
from service.body_limit import BodyLimit
from service.machine_state import MachineState
from service.metrics import Metrics, RequestMetrics
from service.request_id import RequestIds
from service.routes import compensate, datum, error_map, errors, health, machines, metrics, telemetry
from service.security_headers import SecurityHeaders
from service.settings import Settings

log = logging.getLogger(__name__)

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


def create_app(
    bundles: Sequence[Bundle],
    settings: Settings,
    clock: Callable[[], float] = time.time,
    steady: Callable[[], float] = time.monotonic,
) -> FastAPI:
    """Return the app that serves these bundles; it is ready once it has started.

    Parameters
    ----------
    clock : epoch seconds
    steady : seconds that never jump, for the rate limit

    Raises
    ------
    InputError
        where two bundles are of the same machine, or a bundle's network cannot be loaded.
    """
    _check_names(bundles)
    states = {bundle.machine.name: MachineState(bundle, settings, clock, steady) for bundle in bundles}

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        app.state.machines = states
        log.info("serving", extra={"machines": sorted(states)})
        yield
        app.state.machines = None

    app = _App(
        title="thermotrue",
        summary="Thermal and volumetric error compensation for machine tools.",
        description=DESCRIPTION,
        version=version("thermotrue"),
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        responses=problems.RESPONSES,
    )
    app.state.metrics = Metrics()
    problems.install(app)
    app.add_middleware(BodyLimit)
    docs.install(app)
    for module in (health, metrics, machines, telemetry, compensate, errors, error_map, datum):
        app.include_router(module.router)
    return app


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
