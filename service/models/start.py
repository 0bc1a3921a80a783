"""What each machine is served with when the service starts: the command line's bundle, or what was activated since."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from sqlalchemy.exc import SQLAlchemyError

from model.bundle import Bundle, parse_bundle, read_files, version_of
from model.exceptions import ThermotrueError
from service.machine_state import MachineState
from service.models.catalogue import (
    Operation,
    Stored,
    activate,
    add,
    add_files,
    stored_files,
    stored_models,
    with_files,
)
from service.models.fits import Installed, check_fits
from service.store import audit
from service.store.journal import Journal
from service.store.store import Store
from service.store.unavailable import StorageUnavailable

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Start:
    """How the service begins.

    Attributes
    ----------
    states : the machines to serve, by name
    installed : what the command line said, by machine
    operations : for the journal once it runs: what is new is known, what serves is active
    files : for the journal one after the other, after these: the files of what the database has not stored yet
    """

    states: dict[str, MachineState]
    installed: dict[str, Installed]
    operations: list[Operation]
    files: list[Operation]

    async def store(self, journal: Journal) -> None:
        """Store the files, each in a transaction of its own: they take long for a hall, and telemetry goes between."""
        with suppress(StorageUnavailable):
            while self.files:
                await journal.write(self.files.pop(0))


Build = Callable[[Bundle], MachineState]


def begin(store: Store, bundles: Sequence[Bundle], build: Build) -> Start:
    """Decide what each machine is served with.

    A bundle of a version that the database has not seen was put there by somebody: it becomes active. Where it was
    seen before, the one that is active in the database serves; where that does not load or does not fit, the command
    line's.

    Parameters
    ----------
    build : makes the machine of a bundle, and proves that the bundle can be served

    Raises
    ------
    BundleError
        where a bundle of the command line cannot be served.
    """
    now_s = time.time()
    start = Start({}, {b.machine.name: Installed.of(b) for b in bundles}, [], [])
    stored: dict[str, dict[str, Stored]] = {}
    whole: set[tuple[str, str]] = set()
    try:
        whole = with_files(store.engine)
        for row in stored_models(store.engine):
            stored.setdefault(row.machine, {})[row.version] = row
    except SQLAlchemyError as problem:
        log.error("models cannot be read", extra={"reason": str(problem)})
    for bundle in bundles:
        name = bundle.machine.name
        known = stored.get(name, {})
        active = next((row for row in known.values() if row.active), None)
        state = None
        if bundle.version in known and active is not None and active.version != bundle.version:
            state = _stored_state(store, active, start.installed[name], build)
        if state is not None:
            versions = {"machine": name, "version": state.bundle.version, "command_line": bundle.version}
            log.warning("an uploaded model serves in place of the command line's", extra=versions)
        state = build(bundle) if state is None else state
        start.states[name], chosen = state, state.bundle
        if bundle.version not in known:
            row = Stored(name, bundle.version, "command-line", now_s, "service", active=False, activated_s=None)
            start.operations.append(add(row))
        if (name, bundle.version) not in whole:
            start.files.append(add_files(name, bundle.version, partial(_files_of, bundle)))
        if active is None or active.version != chosen.version:
            detail = {"version": chosen.version, "from": None if active is None else active.version}
            start.operations.append(activate(name, chosen.version, now_s))
            start.operations.append(audit.record("service", "model activated", name, detail))
    return start


def _stored_state(store: Store, row: Stored, installed: Installed, build: Build) -> MachineState | None:
    """Return the machine of a stored bundle; None, with a sentence in the log, where it cannot be served."""
    try:
        bundle = parse_bundle(stored_files(store.engine, row.machine, row.version), stored_name(row))
        check_fits(installed, bundle)
        return build(bundle)
    except (ThermotrueError, SQLAlchemyError) as problem:
        log.error("stored model cannot be served", extra={"machine": row.machine, "reason": str(problem)})
        return None


def stored_name(row: Stored) -> str:
    """Return what names a stored model in messages."""
    return f"database/{row.machine}/{row.version}"


def _files_of(bundle: Bundle) -> dict[str, bytes]:
    """Return the files of a bundle's folder; none where another bundle stands there by now."""
    try:
        files = read_files(bundle.path)
        if version_of(files) == bundle.version:
            return files
        reason = "its folder has another bundle by now"
    except ThermotrueError as problem:
        reason = str(problem)
    log.warning("model not stored", extra={"machine": bundle.machine.name, "reason": reason})
    return {}
