"""The shelf: a service's models, and the one way from an uploaded file to what a machine is served with."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, TypeVar

from sqlalchemy.exc import SQLAlchemyError

from model.bundle import Bundle, parse_bundle
from model.exceptions import ThermotrueError
from service.machine_state import MachineState
from service.models import catalogue
from service.models.archive import unpack
from service.models.catalogue import Stored
from service.models.fits import Installed, check_fits
from service.models.start import stored_name
from service.models.swap import DatumMoved, Swap
from service.problems import Problem
from service.store import audit
from service.store.journal import Operation
from service.store.store import Store
from service.store.unavailable import StorageUnavailable

log = logging.getLogger(__name__)

MAX_MODELS = 32
"""Models kept of one machine: each may have megabytes, and nobody finds the way among more."""
DURABLE_S = 10.0
"""How long a change waits for the database [s]: files of megabytes take a while."""
ATTEMPTS = 3
"""How often a model is built anew where the datum is changed meanwhile."""

Found = TypeVar("Found")


@dataclass(frozen=True)
class Kept:
    """A model on the shelf: its row, what its manifest says, and whether its files are there."""

    row: Stored
    active: bool
    summary: Mapping[str, Any] | None


class Shelf:
    """The models of all machines.

    Parameters
    ----------
    store : where they are kept
    installed : what the command line said, by machine
    """

    def __init__(self, store: Store, installed: Mapping[str, Installed]) -> None:
        self._store, self._installed = store, installed
        self._locks: defaultdict[str, asyncio.Lock] = defaultdict(asyncio.Lock)

    async def models(self, state: MachineState) -> list[Kept]:
        """Return a machine's models, newest first."""
        name, served = state.machine.name, state.bundle.version

        def read() -> tuple[list[Stored], dict[str, dict[str, Any]]]:
            rows = catalogue.stored_models(self._store.engine, name)
            return rows, catalogue.summaries(self._store.engine, name)

        rows, summaries = await _reading(read)
        return [Kept(row, row.version == served, summaries.get(row.version)) for row in rows]

    async def upload(self, state: MachineState, body: bytes, who: str) -> tuple[Stored, bool]:
        """Verify a bundle and keep it; return its row, and whether it is new.

        Raises
        ------
        Problem
            422 `broken-bundle` where it is not a whole bundle of this machine that works here; 409 where there are
            too many; 503 where the database does not take it.
        """
        name = state.machine.name
        async with self._locks[name]:
            try:
                files, bundle = await asyncio.to_thread(self._verified, state, body)
            except ThermotrueError as problem:
                log.warning("model refused", extra={"machine": name, "who": who, "reason": str(problem)})
                raise Problem(HTTPStatus.UNPROCESSABLE_ENTITY, "broken-bundle", str(problem)) from None
            rows = {r.version: r for r in await self._rows(name)}
            known = rows.get(bundle.version)
            if known is None and len(rows) >= MAX_MODELS:
                detail = f"machine '{name}' must have at most {MAX_MODELS} models, got one more; delete some"
                raise Problem(HTTPStatus.CONFLICT, "too-many-models", detail)
            row = known or Stored(name, bundle.version, "upload", time.time(), who, active=False, activated_s=None)
            await self._write(
                catalogue.add(row),
                catalogue.add_files(name, row.version, lambda: files),
                audit.record(who, "model uploaded", name, {"version": row.version, "bytes": len(body)}),
            )
            log.info("model uploaded", extra={"machine": name, "version": row.version, "who": who})
            return row, known is None

    async def activate(self, state: MachineState, version: str, who: str, action: str = "model activated") -> list[str]:
        """Serve a machine with another of its models from now on; return what is not as before.

        The network's state is rebuilt from stored telemetry beside the one that serves, which goes on meanwhile.

        Raises
        ------
        Problem
            404 for a version that is not there, 409 for one that cannot be served, 503 where the database fails.
        """
        name = state.machine.name
        async with self._locks[name]:
            row = await self._row(name, version)
            before = state.bundle.version
            warnings = [] if version == before else await self._swap(state, row)
            detail = {"version": version, "from": before}
            if version != before or not row.active:
                log.info(action, extra={"machine": name, "version": version, "before": before, "who": who})
                await self._write(
                    catalogue.activate(name, version, time.time()), audit.record(who, action, name, detail)
                )
            return warnings

    async def roll_back(self, state: MachineState, who: str) -> tuple[str, list[str]]:
        """Activate what was active before; return its version, and what is not as before."""
        name = state.machine.name
        others = [r for r in await self._rows(name) if r.activated_s is not None and r.version != state.bundle.version]
        if not others:
            detail = f"machine '{name}' must have had another model to go back to, and has had none; activate one"
            raise Problem(HTTPStatus.CONFLICT, "no-earlier-model", detail)
        version = max(others, key=lambda r: r.activated_s or 0.0).version
        return version, await self.activate(state, version, who, "model rolled back")

    async def remove(self, state: MachineState, version: str, who: str) -> None:
        """Delete a model that is not active."""
        name = state.machine.name
        async with self._locks[name]:
            row = await self._row(name, version)
            if row.active or version == state.bundle.version:
                detail = f"model '{version}' of machine '{name}' is active; activate another one before it is deleted"
                raise Problem(HTTPStatus.CONFLICT, "model-active", detail)
            await self._write(
                catalogue.remove(name, version), audit.record(who, "model deleted", name, {"version": version})
            )

    def _verified(self, state: MachineState, body: bytes) -> tuple[dict[str, bytes], Bundle]:
        """Return an upload's files and bundle once all checks have passed; in a thread."""
        files = unpack(body)
        bundle = parse_bundle(files, "upload")
        check_fits(self._installed[state.machine.name], bundle)
        MachineState(bundle, state.settings, state.clock, state.steady)  # loads the network and replays its sample
        return files, bundle

    async def _swap(self, state: MachineState, row: Stored) -> list[str]:
        for _ in range(ATTEMPTS):
            try:
                return await self._swap_once(state, row)
            except DatumMoved:
                continue
        detail = f"the datum of machine '{row.machine}' kept changing while the model was built; call again"
        raise Problem(HTTPStatus.CONFLICT, "datum-moved", detail)

    async def _swap_once(self, state: MachineState, row: Stored) -> list[str]:
        with Swap(state) as swap:  # from here on it gets the samples that come in
            await self._store.journal.durable(DURABLE_S)
            try:
                other, warnings = await _reading(lambda: swap.build(self._store.engine, self._stored(state, row)))
            except ThermotrueError as problem:
                if isinstance(problem, Problem):
                    raise
                log.warning("model not activated", extra={"machine": row.machine, "reason": str(problem)})
                raise Problem(HTTPStatus.CONFLICT, "model-not-usable", str(problem)) from None
            swap.finish(other)
            if state.recorder is not None:
                state.recorder.snapshot(state)
            return warnings

    def _stored(self, state: MachineState, row: Stored) -> Bundle:
        bundle = parse_bundle(catalogue.stored_files(self._store.engine, row.machine, row.version), stored_name(row))
        check_fits(self._installed[state.machine.name], bundle)
        return bundle

    async def _rows(self, name: str) -> list[Stored]:
        return await _reading(lambda: catalogue.stored_models(self._store.engine, name))

    async def _row(self, name: str, version: str) -> Stored:
        rows = {row.version: row for row in await self._rows(name)}
        if version not in rows:
            known = ", ".join(rows) or "none"
            detail = f"unknown model '{version[:64]}' of machine '{name}'; there are {known}"
            raise Problem(HTTPStatus.NOT_FOUND, "unknown-model", detail)
        return rows[version]

    async def _write(self, *operations: Operation) -> None:
        """Write operations, and return once they are durable."""
        written = [self._store.journal.write(operation) for operation in operations]
        await self._store.journal.durable(DURABLE_S)
        for future in written:
            await future


async def _reading(read: Callable[[], Found]) -> Found:
    """Read from the database in a thread."""
    try:
        return await asyncio.to_thread(read)
    except SQLAlchemyError as problem:
        raise StorageUnavailable(f"and could not be read: {type(problem).__name__}") from None
