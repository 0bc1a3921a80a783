"""A swap of models under way: the new one is built beside the one that serves, and takes its place in one step."""

from __future__ import annotations

from types import TracebackType

from sqlalchemy import Engine

from model.bundle import Bundle
from model.exceptions import BundleError
from service.machine_state import MachineState
from service.restore import rebuild
from service.schemas import Sample


class DatumMoved(Exception):
    """The datum was changed while a model was built."""


class Swap:
    """One swap; while it is open, samples that the machine takes are kept for the new model as well.

    Parameters
    ----------
    state : the machine, which goes on serving meanwhile
    """

    def __init__(self, state: MachineState) -> None:
        self._state, self._arrived = state, list[Sample]()
        self._memory = None if state.thermal is None else state.thermal.memory()

    def __enter__(self) -> Swap:
        self._state.watchers.append(self._arrived)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._state.watchers = [w for w in self._state.watchers if w is not self._arrived]

    def build(self, engine: Engine, bundle: Bundle) -> tuple[MachineState, list[str]]:
        """Return the machine with the new bundle, at the thermal state of now, and what is not as before; in a thread.

        Raises
        ------
        BundleError
            where the network does not work here, or not on what the machine's sensors have told.
        """
        old = self._state
        new = MachineState(bundle, old.settings, old.clock, old.steady)
        if new.thermal is None or self._memory is None:  # telemetry was of no use before, and is not complete
            return new, []
        found = rebuild(bundle, self._memory, engine)
        new.thermal = found.thermal
        if self._memory.state is not None and new.thermal.state is None:
            reason = new.thermal.failure or "there is no telemetry in the database to begin with"
            raise BundleError(
                f"bundle '{bundle.path}' must work on the machine's telemetry, and does not: {reason}; "
                "the model before goes on"
            )
        return new, list(found.warnings)

    def finish(self, new: MachineState) -> None:
        """Put the new model in the old one's place; on the loop, between two requests.

        Raises
        ------
        DatumMoved
            where the datum is not the one that the new model was built with.
        """
        thermal = self._state.thermal
        if thermal is not None and self._memory is not None and thermal.zero is not self._memory.zero:
            raise DatumMoved
        if new.thermal is not None:
            for sample in sorted(self._arrived, key=lambda s: s.time):
                new.thermal.take(sample)
        self._state.adopt(new)
