"""What is kept of a run when it is written."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from data_synth.faults import KINDS
from data_synth.network import Array
from data_synth.run import Run


@dataclass(frozen=True)
class RunSummary:
    """A run in a few numbers.

    Attributes
    ----------
    began : day of the year, from 1, and hour of the week, from Monday's midnight
    drift_um : root mean square of the tip's drift since the run's start, over time and the working volume
    furthest_um, furthest_s : the largest of it, and when
    absolute_um : root mean square of the tip's deviation from the uniform reference temperature
    low_degC, high_degC : of each sensor, shape (S,), NaN where it showed nothing
    faults : how many there are of each kind; empty where none were asked for
    """

    name: str
    began: tuple[int, float]
    drift_um: float
    furthest_um: float
    furthest_s: float
    absolute_um: float
    low_degC: Array
    high_degC: Array
    faults: dict[str, int]

    @classmethod
    def of(cls, run: Run, deviation_um: Array) -> RunSummary:
        """Return the summary of a run and its tip deviations (u, places, 3)."""
        drift = np.linalg.norm(deviation_um - deviation_um[:1], axis=-1)
        shown = np.array(list(run.sensors.values()))
        kinds = None if run.faults is None else [fault.kind for fault in run.faults]
        return cls(
            name=run.name,
            began=(int(run.clock.day_of_year) + 1, run.clock.hour_of_week),
            drift_um=_rms(drift),
            furthest_um=float(drift.max()),
            furthest_s=float(run.terms_time_s[int(drift.max(axis=1).argmax())]),
            absolute_um=_rms(np.linalg.norm(deviation_um, axis=-1)),
            low_degC=np.fmin.reduce(shown, axis=1),
            high_degC=np.fmax.reduce(shown, axis=1),
            faults={} if kinds is None else {kind: kinds.count(kind) for kind in KINDS},
        )


def total_drift_um(runs: Iterable[RunSummary]) -> float:
    """Return the root mean square of the drift over all runs."""
    return _rms(np.array([run.drift_um for run in runs]))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
