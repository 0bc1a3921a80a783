"""What a machine's service does is recorded as it happens: telemetry at once, snapshots where they are due."""

from __future__ import annotations

import json
import logging
import math
import time
from array import array
from bisect import bisect_left, insort
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sqlalchemy import Connection

from model.error_map import ErrorMap
from model.predictor import ThermalState
from model.terms import UM
from service.schemas import Sample
from service.snapshot import Snapshot, to_json
from service.store.journal import Insert
from service.store.store import Store
from service.store.tables import snapshots, telemetry
from service.thermal import Zero
from service.timestamps import format_time

if TYPE_CHECKING:
    from service.machine_state import MachineState

log = logging.getLogger(__name__)

MOVED_UM = 0.5
"""How far a correction may have moved since the snapshot [µm]. It is looked at as often as the rate limit lets it
move so far, so a process that is killed forgets at most twice as much."""

MOST_MISSING = 100_000
"""Times of samples of one machine that are remembered for when they come again, of 8 bytes each."""


class Recorder:
    """Records one machine.

    Parameters
    ----------
    machine : its name
    store : where to
    every_s : the longest time between snapshots while anything changes
    """

    def __init__(self, machine: str, store: Store, every_s: float) -> None:
        self.machine, self.store, self.every_s = machine, store, every_s
        self._missing = array("d")  # times of samples, rising
        self._kept = _Contents(None, None, None, None, 0.0)
        self._kept_s = self._looked_s = -math.inf

    def samples(self, taken: Sequence[Sample], late: Sequence[Sample]) -> bool:
        """Record samples that the thermal state took, whether it could use them or not; return whether all are queued.

        Where so many wait for the database that no more are queued, they are remembered as missing, and recorded when
        they come again: their sender must get an error.

        Parameters
        ----------
        late : samples of no use since the state is newer
        """
        again = {s.time: s for s in late if self._is_missing(s.time)} if self._missing else {}
        if not taken and not again:
            return True
        journal = self.store.journal
        if journal.full:
            for one in taken:
                self._miss(one.time)
            return False
        for time_s in again:
            self._missing.pop(bisect_left(self._missing, time_s))
        received_s = time.time()
        journal.add(Insert(telemetry, [_row(self.machine, s, received_s) for s in (*taken, *again.values())]))
        return True

    def served(self, state: MachineState) -> None:
        """Take a snapshot where what is served has moved away from the last one."""
        served = state.served
        if served is None or not self.store.lasting:
            return
        kept = self._kept.errors
        # How far it had to go tells a restart how much time may count, so that must not be much more than it is.
        nearer = self._kept.remaining_um - served.remaining_um > MOVED_UM
        if served.errors is kept and not nearer:
            return
        pause_s = MOVED_UM / state.machine.limits.max_rate_um_per_min * 60.0
        if kept is not None and served.time_s - self._looked_s < pause_s:
            return
        self._looked_s = served.time_s
        if kept is None or nearer or state.reach.correction_mm(served.errors - kept) / UM > MOVED_UM:
            self.snapshot(state)

    def tick(self, state: MachineState) -> None:
        """Take a snapshot where the last one is old and anything has changed."""
        if state.steady() - self._kept_s >= self.every_s and not _Contents.of(state).same(self._kept):
            self.snapshot(state)

    def snapshot(self, state: MachineState, *, last: bool = False) -> None:
        """Take a snapshot now; one that still waits to be written is replaced by it."""
        if not self.store.lasting:
            return
        self._kept, self._kept_s = _Contents.of(state), state.steady()
        save = _Save(self.machine, state.snapshot(last=last), state.clock())
        self.store.journal.write_latest(("snapshot", self.machine), save)

    def _is_missing(self, time_s: float) -> bool:
        at = bisect_left(self._missing, time_s)
        return at < len(self._missing) and self._missing[at] == time_s

    def _miss(self, time_s: float) -> None:
        if not self._is_missing(time_s):
            insort(self._missing, time_s)
        if len(self._missing) > MOST_MISSING:
            log.error("sample not stored", extra={"machine": self.machine, "sample": format_time(self._missing.pop(0))})


@dataclass(frozen=True)
class _Contents:
    """What a snapshot holds; none of it is ever changed in place."""

    state: ThermalState | None
    zero: Zero | None
    errors: ErrorMap | None
    served_s: float | None
    remaining_um: float

    @classmethod
    def of(cls, machine: MachineState) -> _Contents:
        thermal, served = machine.thermal, machine.served
        return cls(
            None if thermal is None else thermal.state,
            None if thermal is None else thermal.zero,
            None if served is None else served.errors,
            None if served is None else served.time_s,
            0.0 if served is None else served.remaining_um,
        )

    def same(self, other: _Contents) -> bool:
        same_objects = self.state is other.state and self.zero is other.zero and self.errors is other.errors
        return same_objects and self.served_s == other.served_s


class _Save:
    """The operation that stores a snapshot. The text is made here, in the journal's thread."""

    def __init__(self, machine: str, snapshot: Snapshot, saved_s: float) -> None:
        self._machine, self._snapshot, self._saved_s = machine, snapshot, saved_s

    def __call__(self, connection: Connection) -> None:
        row = {
            "machine": self._machine,
            "saved_s": self._saved_s,
            "time_s": self._snapshot.time_s,
            "model": self._snapshot.model,
            "state": to_json(self._snapshot),
        }
        connection.execute(snapshots.delete().where(snapshots.c.machine == self._machine))
        connection.execute(snapshots.insert(), row)


def _row(machine: str, sample: Sample, received_s: float) -> dict[str, object]:
    content = {"temperatures": sample.temperatures, "channels": sample.channels}
    return {
        "machine": machine,
        "time_s": sample.time,
        "received_s": received_s,
        "sample": json.dumps(content, separators=(",", ":")),
    }
