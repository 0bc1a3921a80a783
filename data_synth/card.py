"""The data card: how a data set was made, from which seeds and constants, and what is in it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, is_dataclass
from itertools import chain

import numpy as np

from data_synth.design import Design
from data_synth.environment import SHOP, SWINGING
from data_synth.network import REST, Array
from data_synth.run import CONDITION_S, CONDITION_SPREAD, PERIOD_S, POSITIONS, TERMS_PERIOD_S, Run


@dataclass(frozen=True)
class RunSummary:
    """What is kept of a run when it is written.

    Attributes
    ----------
    drift_um : root mean square of the tip's drift since the run's start, over time and the working volume
    furthest_um : the largest of it
    absolute_um : root mean square of the tip's deviation from the uniform reference temperature
    low_degC, high_degC : of each sensor, shape (S,)
    """

    name: str
    drift_um: float
    furthest_um: float
    absolute_um: float
    low_degC: Array
    high_degC: Array

    @classmethod
    def of(cls, run: Run, deviation_um: Array) -> RunSummary:
        """Return the summary of a run and its tip deviations (t, places, 3)."""
        drift = np.linalg.norm(deviation_um - deviation_um[:1], axis=-1)
        shown = np.array(list(run.sensors.values()))
        absolute = np.linalg.norm(deviation_um, axis=-1)
        return cls(run.name, _rms(drift), float(drift.max()), _rms(absolute), shown.min(1), shown.max(1))


def total_drift_um(runs: Iterable[RunSummary]) -> float:
    """Return the root mean square of the drift over all runs."""
    return _rms(np.array([run.drift_um for run in runs]))


def card(
    design: Design, sensors: tuple[str, ...], runs: list[RunSummary], seed: int, hours: float, command: str
) -> str:
    """Return the text of a data set's README.md."""
    return "\n".join(
        chain(
            _head(design, runs, seed, hours, command),
            ["", "## Runs", ""],
            _table(
                ("run", "rms drift since start [µm]", "largest [µm]", "rms deviation from 20 °C [µm]"),
                ((r.name, f"{r.drift_um:.1f}", f"{r.furthest_um:.1f}", f"{r.absolute_um:.1f}") for r in runs),
            ),
            ["", "## Sensors", ""],
            _sensors(design, sensors, runs),
            ["", "## Constants", "", "Sources stand beside them in `data_synth/`.", ""],
            _constants(design),
            [""],
        )
    )


def _head(design: Design, runs: list[RunSummary], seed: int, hours: float, command: str) -> Iterator[str]:
    yield f"# Synthetic data set: machine {design.name}, seed {seed}"
    yield ""
    yield f"Made by `{command}`: {len(runs)} runs of {hours:g} h. The same command gives the same bytes."
    yield f"Run number i is a function of the machine, its duty cycle and the seed ({seed}, i) alone."
    yield ""
    yield "![Temperatures and tip drift of the first run](overview.png)"
    yield ""
    yield f"- `telemetry`: every {PERIOD_S:g} s; channels are means over the {PERIOD_S:g} s before a row."
    yield f"- `error_terms`: every {TERMS_PERIOD_S:g} s, thermal only, motion terms at {POSITIONS} positions,"
    yield "  without noise, relative to the machine at its uniform reference temperature."
    yield "- `geometry.csv`: the cold errors, which `error_terms` does not hold."
    yield "- Not in the telemetry, as in life: cutting load, strokes, draughts, chiller, door, the condition of"
    yield "  bearings and nuts, the hours before power-on."


def _sensors(design: Design, sensors: tuple[str, ...], runs: list[RunSummary]) -> Iterator[str]:
    low = np.min([run.low_degC for run in runs], axis=0)
    high = np.max([run.high_degC for run in runs], axis=0)
    rows = []
    for k, name in enumerate(sensors):
        meter = design.thermometers[name]
        at = " + ".join(f"{share:g} {node}" for node, share in meter.at.items())
        constants = (f"{value:g}" for value in (meter.lag_s, meter.noise_K, meter.step_K))
        rows.append((name, at, *constants, f"{low[k]:.1f} to {high[k]:.1f}"))
    yield from _table(("sensor", "feels", "lag [s]", "noise [K]", "step [K]", "shown [°C]"), rows)


def _constants(design: Design) -> Iterator[str]:
    network = design.network
    loss = np.diag(network.conductances(REST)[0])
    yield from _table(
        ("node", "capacity [J/K]", "conductance at rest [W/K]", "own time constant [min]"),
        (
            (name, f"{c:.0f}", f"{g:.2f}", f"{c / g / 60:.1f}")
            for (name, c), g in zip(network.capacities.items(), loss, strict=True)
        ),
    )
    yield ""
    links = ((k.a, k.b, f"{k.W_per_K:.3g}", _values(k.film)) for k in network.links)
    yield from _table(("from", "to", "[W/K]", "film: share still and what is added"), links)
    yield ""
    yield from _table(("heat source", "constants"), ((type(s).__name__, _values(s)) for s in design.sources))
    yield ""
    others = {
        "structure": design.structure,
        "capability": design.capability,
        "workmanship": design.workmanship,
        "climate": SHOP,
        "climate of `night` runs": SWINGING,
    }
    rows = [(name, _values(part)) for name, part in others.items()]
    rows.append(("condition of sources", f"spread {CONDITION_SPREAD:g}, correlation time {CONDITION_S:g} s"))
    yield from _table(("part", "constants"), rows)


def _values(part: object) -> str:
    assert is_dataclass(part)
    assert not isinstance(part, type)
    return ", ".join(f"{name} = {_plain(value)}" for name, value in asdict(part).items())


def _plain(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {_plain(v)}" for k, v in value.items()) + "}"
    if isinstance(value, tuple):
        return "(" + ", ".join(map(_plain, value)) + ")"
    return str(value)


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    yield f"| {' | '.join(head)} |"
    yield f"| {' | '.join('---' for _ in head)} |"
    for row in rows:
        yield f"| {' | '.join(row)} |"


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
