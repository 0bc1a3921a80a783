"""The application: bundles in, a FastAPI app out."""

from __future__ import annotations

import logging
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from importlib.metadata import version

from fastapi import FastAPI

from model.bundle import Bundle
from model.exceptions import InputError
from service import docs, problems
from service.body_limit import BodyLimit
from service.machine_state import MachineState
from service.routes import compensate, datum, errors, health, machines, telemetry
from service.settings import Settings

log = logging.getLogger(__name__)


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

    app = FastAPI(
        title="thermotrue",
        summary="Thermal and volumetric error compensation for machine tools.",
        version=version("thermotrue"),
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        responses=problems.RESPONSES,
    )
    problems.install(app)
    app.add_middleware(BodyLimit)
    docs.install(app)
    app.include_router(health.router)
    for module in (machines, telemetry, compensate, errors, datum):
        app.include_router(module.router, prefix="/v1")
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
