"""The report's tables, as text: the page escapes it."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from model.fields import Fields
from model.machine import Machine
from model.sensors import SensorModel
from model.term_classes import meaning
from model.transforms import Array
from training.coverage import columns_by_term
from training.dataset import DataSet
from training.evaluation import NETWORK, NO_COMPENSATION
from training.job import Result
from training.report.figures import symbol
from training.report.left_out import LeftOutRun, best_baseline, position_text
from training.report.moments import Moment
from training.report.units import (
    NEAR,
    channel_value,
    clock,
    duration,
    flat,
    micrometres,
    number,
    percent,
    plain,
)
from training.tip import TipMetric

WORST_PLACES = 10
"""Positions of the tip that are told at the worst moment."""
MOST_ROWS = 40
"""Rows of a table of runs; a page is for reading, the rest is counted in a line."""


@dataclass(frozen=True)
class PageTable:
    """A table of the page.

    Attributes
    ----------
    caption : what it shows
    head : one for each column
    rows : cells as text
    text_columns : how many columns from the left are text; the others are numbers and stand to the right
    marked : rows in bold
    """

    caption: str
    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    text_columns: int = 1
    marked: set[int] = field(default_factory=set)


def scores(result: Result) -> PageTable:
    """Return what each method leaves, side by side."""
    best = best_baseline(result)
    rows = []
    for name, score in result.scores.items():
        beside = score.rms_um / result.scores[best].rms_um if best is not None else float("nan")
        cells = (micrometres(score.rms_um), percent(score.share), micrometres(score.worst_um), f"{beside:.2f}")
        rows.append((name, *(cells if best is not None else cells[:-1])))
    head: tuple[str, ...] = ("method", "rms", "share left", "worst moment")
    if best is not None:
        head = (*head, f"beside {best}")
    caption = f"Residual deviation of the tool tip over the working volume, left out: {result.left_out}."
    return PageTable(caption, head, rows, 1, {list(result.scores).index(NETWORK)})


def scores_by_run(result: Result) -> PageTable | None:
    """Return the same run by run; None where one run was left out."""
    runs = list(result.scores[NO_COMPENSATION].by_run_um)
    if len(runs) < 2:
        return None
    runs.sort(key=lambda run: -result.scores[NETWORK].by_run_um[run])
    head: tuple[str, ...] = ("run", *result.scores)
    rows = [(run, *(micrometres(score.by_run_um[run]) for score in result.scores.values())) for run in runs]
    if result.interval is not None:
        head = (*head, f"within the 95{NEAR}% interval")
        within = {name: percent(one.within) for name, one in result.interval.by_run.items()}
        rows = [(*row, within.get(row[0], "–")) for row in rows]
    return _cut(PageTable("Root mean square, run by run, worst first.", head, rows))


def data(result: Result) -> PageTable:
    """Return the data set in a few lines."""
    dataset, machine = result.dataset, result.dataset.machine
    telemetry = [run.telemetry for run in dataset.runs.values()]
    ranges = ", ".join(
        f"{a} {plain(machine.axes[a].low)} to {plain(machine.axes[a].high)} {machine.axes[a].unit}"
        for a in machine.axis_names
    )
    datum = {
        "run-start": "run-start: deviations count from the first sample of their run",
        "absolute": "absolute: deviations count from the machine at "
        f"{plain(machine.reference_temperature_degC)}{NEAR}°C",
    }[dataset.datum]
    rows = [
        ("machine", f"{machine.name}; {ranges}"),
        ("data set", f"{dataset.path.name} (SHA-256 {dataset.fingerprint[:12]})"),
        ("runs", f"{len(dataset.runs)}, {duration(sum(float(np.ptp(t.time_s)) for t in telemetry))} in all"),
        ("telemetry", f"{sum(len(t.time_s) for t in telemetry)} samples of {_count(dataset.sensors, 'sensor')}"
         f" and {_count(dataset.channels, 'channel')}"),
        ("measurements", f"{sum(len(r.time_s) for r in dataset.runs.values())} times; "
         f"{_count(dataset.measured_terms, 'error term')} of the machine's {len(machine.terms)}"
         + ("; the tool tip itself" if dataset.places else "")),
        ("datum", datum),
        ("cold errors", f"{len(dataset.geometry)} rows of geometry" if dataset.geometry else "no geometry was given"),
        ("left out", result.left_out + (f"; {result.note}" if result.note else "")),
    ]  # fmt: skip
    return PageTable("The data set.", ("", ""), rows, 2)


def runs(result: Result) -> PageTable:
    """Return the runs."""
    dataset, metric = result.dataset, result.metric
    rows = []
    for name, run in dataset.runs.items():
        telemetry = run.telemetry
        steps = np.diff(telemetry.time_s)
        missing = float(np.isnan(telemetry.temperatures).mean())
        drift = np.sqrt(metric.mean_square(metric.sample(run.values)))
        out = result.tested.get(name, np.zeros(0, dtype=bool))
        use = "left out" if out.any() and out.all() else "partly left out" if out.any() else "trained on"
        rows.append(
            (
                name,
                use,
                duration(float(np.ptp(telemetry.time_s))),
                duration(float(np.median(steps))) if len(steps) else "–",
                str(len(run.time_s)),
                percent(missing) if missing else "none",
                f"{number(float(np.nanmin(telemetry.temperatures)))} to "
                f"{number(float(np.nanmax(telemetry.temperatures)))}{NEAR}°C",
                micrometres(float(drift.max())),
            )
        )
    head = ("run", "use", "length", "sample every", "measured", "readings missing", "temperatures", "largest deviation")
    caption = "Runs. The largest deviation is the tip's, root mean square over the working volume."
    return _cut(PageTable(caption, head, rows, 2))


def inputs(result: Result) -> PageTable:
    """Return the sensors and channels."""
    dataset = result.dataset
    temperatures = np.concatenate([run.telemetry.temperatures for run in dataset.runs.values()])
    channels = np.concatenate([run.telemetry.channels for run in dataset.runs.values()])
    rows: list[tuple[str, ...]] = []
    for i, name in enumerate(dataset.sensors):
        mine = temperatures[:, i]
        missing = float(np.isnan(mine).mean())
        span = [float(np.ptp(r.telemetry.temperatures[np.isfinite(r.telemetry.temperatures[:, i]), i]))
                for r in dataset.runs.values()]  # fmt: skip
        rows.append(
            (
                name,
                "sensor",
                f"{number(float(np.nanmin(mine)))}{NEAR}°C",
                f"{number(float(np.nanmax(mine)))}{NEAR}°C",
                f"{number(max(span))}{NEAR}K",
                percent(missing) if missing else "none",
            )
        )
    for i, name in enumerate(dataset.channels):
        mine = channels[:, i]
        span = [float(np.ptp(r.telemetry.channels[:, i])) for r in dataset.runs.values()]
        ends = (channel_value(name, float(v)) for v in (mine.min(), mine.max(), max(span)))
        rows.append((name, "switch" if len(np.unique(mine)) <= 2 else "channel", *ends, "none"))
    head = ("input", "kind", "lowest", "highest", "most in one run", "readings missing")
    return PageTable("Inputs of the network over all runs.", head, rows, 2)


def terms(result: Result, runs: Sequence[LeftOutRun], counts: dict[str, Array]) -> PageTable | None:
    """Return each measured term, the most harmful first: where, how often, how large, and what the network leaves.

    None where no term was measured.
    """
    dataset, metric, machine = result.dataset, result.metric, result.dataset.machine
    columns = columns_by_term(dataset.columns)
    found: list[tuple[float, tuple[str, ...]]] = []
    for name, where in metric.slices().items():
        term = machine.term(name)
        largest = max(float(np.nanmax(np.abs(r.values[:, columns[name]]), initial=0.0)) for r in dataset.runs.values())
        drift, left = (_alone(result, runs, where, method) for method in (NO_COMPENSATION, NETWORK))
        places = "–" if term.kind == "location" else _places(dataset, name, columns[name])
        times = str(int(counts[name].max()))
        size = micrometres(largest, symbol(term))
        row = (name, meaning(machine, term), places, times, size, micrometres(drift), micrometres(left))
        found.append((drift, row))
    rows = [row for _, row in sorted(found, key=lambda entry: -entry[0])]
    head = ("term", "what it is", "positions", "times", "largest", "moves the tip by", "network leaves")
    caption = (
        "Measured error terms. The last two columns are of the left-out measurements: root mean square over the volume "
        "of what the term alone does to the tip, and of what the network leaves of it."
    )
    return PageTable(caption, head, rows, 3) if rows else None


def not_learned(dataset: DataSet) -> list[str]:
    """Return the machine's terms that the data set says nothing of."""
    return [term.name for term in dataset.machine.terms if term.name not in dataset.terms]


def learned_from_tip(dataset: DataSet) -> list[str]:
    """Return the terms that are known from the tip's deviations alone."""
    return [name for name in dataset.terms if name not in dataset.measured_terms]


def _places(dataset: DataSet, name: str, columns: NDArray[np.intp]) -> str:
    at = [dataset.columns[j][1] or 0.0 for j in columns]
    unit = dataset.machine.axes[dataset.machine.term(name).axis].unit
    return f"{len(at)}, from {plain(min(at))} to {plain(max(at))} {unit}"


def _alone(result: Result, runs: Sequence[LeftOutRun], where: slice, method: str) -> float:
    squares = []
    for run in runs:
        only = np.full_like(run.truth, np.nan)
        only[:, where] = (run.truth - run.said[method])[:, where]
        squares.append(result.metric.mean_square(only)[run.scored])
    return float(np.sqrt(np.concatenate(squares).mean())) if squares else 0.0


def moments(found: Sequence[Moment]) -> PageTable:
    """Return the worst moments."""
    rows = []
    for m in found:
        doing = "; ".join(
            f"{name} {channel_value(name, now)}"
            + ("" if np.isclose(now, mean) else f" (mean {channel_value(name, mean)})")
            for name, (now, mean) in m.channels.items()
            if now != 0.0 or mean != 0.0
        )
        if m.channels and not doing:
            doing = f"at rest for an hour: {', '.join(m.channels)} 0"
        change = ""
        if m.fastest is not None:
            sensor, kelvin = m.fastest
            change = f"{sensor} {number(kelvin, 2) if kelvin < 0 else '+' + number(kelvin, 2)}{NEAR}K"
        blame = ", ".join(f"{name} {micrometres(um)}" for name, um in m.terms) or "only the tip was measured"
        rows.append(
            (m.run.name, doing or "no channels were recorded", change or "–", blame, clock(m.time_s),
             micrometres(m.left_um), micrometres(m.drift_um))
        )  # fmt: skip
    head = (
        "run",
        "machine",
        "fastest sensor over the hour before",
        "terms most off",
        "time",
        "network leaves",
        "drift then",
    )
    caption = (
        "The moments at which the network is furthest off, at least an hour apart within a run, and what the machine "
        "was doing: its channels then, and their mean over the hour before."
    )
    return PageTable(caption, head, rows, 4)


def settings(result: Result) -> PageTable:
    """Return the settings and what it was trained with."""
    trained = result.bundle.manifest.training
    record = result.bundle.manifest.network
    rows = flat(trained.get("settings", {}))
    choice = None if result.making is None else result.making.choice
    if choice is not None and choice.left is not None and choice.left_before is not None:
        left = f"{percent(choice.left)} left of runs left out, {percent(choice.left_before)} with the sizes given"
        rows.append(("sizes and penalty", f"chosen: {left}"))
    if record is not None:
        rows.append(("settling time (measured)", duration(record.settling_time_s)))
        rows.append(("modes", str(record.modes)))
        rows.append(("ONNX", f"opset {record.opset}, {record.exporter}"))
    libraries = ", ".join(f"{name} {version(name)}" for name in ("thermotrue", "numpy", "torch", "onnxruntime"))
    rows.append(("software", f"Python {platform.python_version()}, {libraries}"))
    return PageTable("Settings of the training; the same settings, data and seed give the same network.",
                     ("setting", "value"), rows, 2)  # fmt: skip


def times(result: Result) -> PageTable | None:
    """Return how long each part took."""
    if result.making is None:
        return None
    seconds = result.making.seconds
    rows = [(part, f"{s:.1f} s") for part, s in seconds.items()]
    rows.append(("together", f"{sum(seconds.values()):.1f} s"))
    return PageTable("How long it took, without this report.", ("part", "time"), rows, 1, {len(rows) - 1})


def tip_at_worst(moment: Moment, metric: TipMetric, machine: Machine) -> PageTable | None:
    """Return the tip's deviation at one time, measured and predicted, worst place first; None where it was not."""
    run = moment.run
    places = run.measured.places
    if places is None:
        return None
    terms = metric.matrix.shape[2]
    measured, predicted = (v[moment.row, terms:].reshape(-1, 3) for v in (run.truth, run.said[NETWORK]))
    left = np.linalg.norm(np.nan_to_num(measured - predicted), axis=1)
    known = np.flatnonzero(np.isfinite(measured).any(axis=1))
    rows: list[tuple[str, ...]] = []
    for p in known[np.argsort(-left[known])][:WORST_PLACES]:
        both = ((v[p] if np.isfinite(v[p]).any() else np.full(3, np.nan)) for v in (measured, predicted))
        cells = (", ".join(micrometres(float(v)) if np.isfinite(v) else "–" for v in tip) for tip in both)
        rows.append((position_text(machine, places[moment.row, p]), *cells, micrometres(float(left[p]))))
    head = ("position", "measured x, y, z", "predicted x, y, z", "left")
    more = f" The {WORST_PLACES} worst of {len(known)} positions." if len(known) > WORST_PLACES else ""
    caption = f"The tool tip's deviation at that moment, worst position first.{more}"
    return PageTable(caption, head, rows, 1) if rows else None


def sensor_model(result: Result) -> SensorModel:
    """Return the bundle's model of the sensors."""
    record = result.bundle.manifest.network
    assert record is not None
    return SensorModel(np.array(record.sensor_mean_degC), np.array(record.sensor_covariance_K2))


def _count(names: Sequence[str], what: str) -> str:
    return f"{len(names)} {what}{'' if len(names) == 1 else 's'}"


def _cut(table: PageTable) -> PageTable:
    more = len(table.rows) - MOST_ROWS
    if more <= 0:
        return table
    return PageTable(
        f"{table.caption} The first {MOST_ROWS}; {more} more are in the data set.",
        table.head,
        table.rows[:MOST_ROWS],
        table.text_columns,
        table.marked,
    )


def location_terms(result: Result, moment: Moment, fields: Fields, coefficients: Array) -> PageTable | None:
    """Return the location terms at one time, measured and predicted; None where none was measured then."""
    dataset, machine = result.dataset, result.dataset.machine
    columns = columns_by_term(dataset.columns)
    values = moment.run.measured.values[moment.row]
    rows = []
    for name in dataset.measured_terms:
        term = machine.term(name)
        if term.kind != "location" or not np.isfinite(values[columns[name]]).any():
            continue
        measured, predicted = float(values[columns[name]][0]), float(coefficients[fields.slices()[name]][0])
        unit = symbol(term)
        cells = (micrometres(v, unit) for v in (measured, predicted, measured - predicted))
        rows.append((name, meaning(machine, term), *cells))
    head = ("term", "what it is", "measured", "predicted", "left")
    return PageTable("Location terms at that moment.", head, rows, 2) if rows else None
