"""The data card: how a data set was made, from which seeds and constants, and what is in it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from itertools import chain

import numpy as np

from data_synth import climates, cycles, siblings
from data_synth.design import Design
from data_synth.machines import DESIGNS, open_shop
from data_synth.network import REST
from data_synth.probe import NOISE_UM, TOUCHES
from data_synth.recipe import Recipe
from data_synth.run import CONDITION_S, CONDITION_SPREAD, Shop
from data_synth.summary import RunSummary

DAYS = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")


@dataclass(frozen=True)
class Picture:
    """A picture of the data set: its file and what it shows."""

    file: str
    shows: str


def card(shop: Shop, recipe: Recipe, runs: list[RunSummary], pictures: list[Picture], form: str) -> str:
    """Return the text of a data set's README.md."""
    return "\n".join(
        chain(
            _head(shop, recipe, runs, form, bool(pictures)),
            ["", "## Tables", ""],
            _tables(shop, recipe),
            ["", "## Runs", ""],
            _runs(recipe, runs),
            ["", "## Pictures"] if pictures else [],
            chain.from_iterable(("", f"![{p.shows}]({p.file})", "", f"*{p.shows}.*") for p in pictures),
            ["", "## Sensors", ""],
            _sensors(shop, runs),
            ["", "## Constants", "", "Sources stand beside them in `data_synth/`.", ""],
            _constants(shop, recipe),
            [""],
        )
    )


def _head(shop: Shop, recipe: Recipe, runs: list[RunSummary], form: str, pictures: bool) -> Iterator[str]:
    yield f"# Synthetic data set: machine {shop.machine.name}, seed {recipe.seed}"
    yield ""
    name, number = siblings.parse(shop.machine.name, DESIGNS) or (shop.machine.name, 0)
    known = open_shop(shop.machine.name).machine == shop.machine
    machine = shop.machine.name if known else "machine.toml"  # the one beside the card
    command = f"thermotrue synth --machine {machine} {recipe.options(shop.machine)} --format {form}"
    command += "" if pictures else " --no-pictures"
    yield f"Made by `{command}`: {len(runs)} runs of {recipe.hours:g} h. The same command gives the same bytes."
    yield f"Run number i is a function of the machine, its duty cycle and the seed ({recipe.seed}, i) alone."
    if number:
        yield ""
        yield siblings.described(name, number)


def _tables(shop: Shop, recipe: Recipe) -> Iterator[str]:
    counts = {name: f"`{name}` ({rows:,} rows)" for name, rows in recipe.rows(shop).items()}
    positions = " or ".join(str(n) for n in sorted({len(p) for p in shop.fields.positions.values()}))
    yield f"- {counts['telemetry']}: every {recipe.period_s:g} s; channels are means over the {recipe.period_s:g} s"
    yield "  before a row."
    yield f"- {counts['error_terms']}: every {recipe.terms_period_s:g} s, thermal only, without noise, relative to the"
    yield f"  machine at its uniform reference temperature; motion terms at {positions} positions."
    if recipe.tool_tip:
        yield f"- {counts['tool_tip']}: at each of those times {TOUCHES} positions drawn from the whole working volume;"
        yield "  thermal and cold errors together by the exact chain, spindle running, with noise of"
        yield f"  {NOISE_UM:g} µm in each coordinate."
    if recipe.faults is not None:
        yield "- `faults`: which readings are known to be wrong, and how."
    yield "- `geometry.csv`: the cold errors, which `error_terms` does not hold."
    yield "- Not in the telemetry, as in life: cutting load, strokes, draughts, chiller, door, the condition of"
    yield "  bearings and nuts, the hours before power-on, how far off a sensor is."


def _runs(recipe: Recipe, runs: list[RunSummary]) -> Iterator[str]:
    yield from _table(
        ("run", "starts", "rms drift since start [µm]", "largest [µm]", "rms deviation from reference [µm]"),
        ((r.name, _began(r), f"{r.drift_um:.1f}", f"{r.furthest_um:.1f}", f"{r.absolute_um:.1f}") for r in runs),
    )
    yield ""
    taken = dict.fromkeys(recipe.kind(i) for i in range(recipe.runs))
    yield from _table(
        ("duty cycle", "what the machine does", "hall"), ((k, cycles.describe(k), _hall(recipe, k)) for k in taken)
    )
    if recipe.faults is not None:
        yield ""
        rates = recipe.faults.per_100h
        total = {kind: sum(run.faults[kind] for run in runs) for kind in rates}
        yield from _table(
            ("fault", "asked for in 100 h of a sensor", "in these runs"),
            ((kind, f"{rate:g}", str(total[kind])) for kind, rate in rates.items()),
        )


def _hall(recipe: Recipe, cycle: str) -> str:
    """Return the name of the climate in which runs of a duty cycle take place."""
    own = cycles.find(cycle).climate
    return recipe.climate or next(name for name, climate in climates.CLIMATES.items() if climate == own)


def _began(run: RunSummary) -> str:
    day, hour = run.began
    minutes = int(hour * 60.0)
    return f"{DAYS[minutes // 1440 % 7]} {minutes // 60 % 24:02d}:{minutes % 60:02d}, day {day}"


def _sensors(shop: Shop, runs: list[RunSummary]) -> Iterator[str]:
    low = np.fmin.reduce([run.low_degC for run in runs])
    high = np.fmax.reduce([run.high_degC for run in runs])
    rows = []
    for k, name in enumerate(shop.machine.sensors):
        meter = shop.design.thermometers[name]
        at = " + ".join(f"{share:g} {node}" for node, share in meter.at.items())
        constants = (f"{value:g}" for value in (meter.lag_s, meter.noise_K, meter.step_K))
        off = f"±({meter.offset_K:g} + {meter.gain:g} t), walks {meter.drift_K:g} in 1000 h"
        rows.append((name, at, *constants, off, f"{low[k]:.1f} to {high[k]:.1f}"))
    yield from _table(("sensor", "feels", "lag [s]", "noise [K]", "step [K]", "calibration [K]", "shown [°C]"), rows)


def _constants(shop: Shop, recipe: Recipe) -> Iterator[str]:
    design = shop.design
    yield from _network(design)
    yield ""
    yield from _table(("heat source", "constants"), ((type(s).__name__, _values(s)) for s in design.sources))
    yield ""
    rows = list(_parts("structure", design.structure))
    rows += [("capability", _values(design.capability)), ("workmanship", _values(design.workmanship))]
    halls = dict.fromkeys(_hall(recipe, recipe.kind(i)) for i in range(recipe.runs))
    rows += [(f"hall `{name}`", _values(climates.find(name))) for name in halls]
    rows.append(("condition of sources", f"spread {CONDITION_SPREAD:g}, correlation time {CONDITION_S:g} s"))
    yield from _table(("part", "constants"), rows)


def _network(design: Design) -> Iterator[str]:
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


def _parts(name: str, part: object) -> Iterator[tuple[str, str]]:
    """Yield a row for each entry of a structure, so that no cell is a page long."""
    assert is_dataclass(part)
    for field in fields(part):
        value = getattr(part, field.name)
        if isinstance(value, Mapping):
            for key, entry in value.items():
                yield f"{name}, {field.name} {key}", _values(entry)
        elif isinstance(value, tuple) and value and is_dataclass(value[0]):
            for entry in value:
                yield f"{name}, {field.name}", _values(entry)
        else:
            yield f"{name}, {field.name}", _values(value)


def _values(part: object) -> str:
    if is_dataclass(part) and not isinstance(part, type):
        return ", ".join(f"{name} = {_plain(value)}" for name, value in asdict(part).items())
    return _plain(part)


def _plain(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
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
