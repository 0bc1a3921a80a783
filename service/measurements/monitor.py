"""What a machine's service remembers of probed deviations: enough to say whether the machine drifts."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from service.measurements.drift import Compared, Component, Drift, assess
from service.status import Condition, Status

MOST = 500
"""Comparisons that count, the newest: some months of sessions; all are gone through anew at each, in milliseconds."""


class Monitor:
    """The newest comparisons of a machine, each with the version of the bundle that predicted."""

    def __init__(self) -> None:
        self._compared: deque[tuple[str, Compared]] = deque(maxlen=MOST)
        self._assessed: tuple[str, Drift] | None = None

    def add(self, version: str, compared: Iterable[Compared]) -> None:
        """Take comparisons in."""
        self._compared.extend((version, one) for one in compared)
        self._assessed = None

    def drift(self, version: str) -> Drift:
        """Return what they say of the machine, as that version of its bundle sees it."""
        if self._assessed is None or self._assessed[0] != version:
            self._assessed = version, assess(one for v, one in self._compared if v == version)
        return self._assessed[1]

    def conditions(self, version: str) -> tuple[Condition, ...]:
        """Return the warning, where the machine drifts."""
        if not self._compared:
            return ()
        found = [_sentence(n, c) for n, c in zip("xyz", self.drift(version).components, strict=True) if c.drifting]
        if not found:
            return ()
        sentence = (
            f"drifting: probed deviations differ from the prediction by {' and '.join(found)}; measure the machine's "
            "geometry, and train its network again if that is as it was"
        )
        return (Condition(Status.DRIFTING, sentence),)


def _sentence(name: str, component: Component) -> str:
    assert component.running_um is not None
    assert component.limit_um is not None
    return f"{component.running_um:+.1f} µm in {name}, beyond ±{component.limit_um:.1f} µm"
