"""Put the report together: one HTML file that loads nothing."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from model.exceptions import DataError
from model.transforms import Array
from training.coverage import columns_by_term
from training.dataset import DataSet
from training.evaluation import NETWORK, NO_COMPENSATION
from training.job import Result
from training.report import figures, tables
from training.report.left_out import LeftOutRun, best_baseline, left_out_runs
from training.report.modes import mode_weights
from training.report.moments import Moment, worst_moments
from training.report.units import clock, micrometres, percent

MARK = '<meta name="generator" content="thermotrue">'
"""In every report, so that none overwrites somebody's own page."""
MOST_FIGURES = 12
"""Left-out runs that are drawn, the worst ones (chosen: four pages on paper)."""


def report_path(bundle: Path) -> Path:
    """Return where the report of a bundle goes: beside its folder, `out/vmc3.html` for `out/vmc3`."""
    bundle = Path(os.path.normpath(bundle))
    return bundle.with_name(bundle.name + ".html")


def check_report(path: Path) -> None:
    """Check that a report could be written, before the work that it is about.

    Raises
    ------
    DataError
        where `path` is a folder, a file that is not a report, or not to be written.
    """
    try:
        if path.is_dir():
            raise DataError(f"report '{path}' must be a file, got a folder; name another --out or give --no-report")
        if path.exists() and MARK not in path.read_text(encoding="utf-8", errors="replace")[:4096]:
            raise DataError(f"'{path}' exists and is not a report; name another --out or give --no-report")
        if path.exists() and not os.access(path, os.W_OK):
            raise DataError(f"report '{path}' cannot be written: no permission")
    except OSError as problem:
        raise DataError(f"report '{path}' cannot be written: {problem.strerror}") from None


def write_report(result: Result, path: Path) -> None:
    """Write the report of a training job.

    Raises
    ------
    DataError
        where the file cannot be written.
    """
    text = render(result)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as problem:
        raise DataError(f"report '{path}' cannot be written: {problem.strerror}") from None


def render(result: Result) -> str:
    """Return the page."""
    runs = left_out_runs(result)
    moments = worst_moments(result.dataset, result.metric, runs)
    environment = Environment(
        loader=PackageLoader("training.report", "."),
        autoescape=True,  # all that comes from data is escaped; only our own figures are not
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    page = environment.get_template("page.html.j2")
    return page.render(
        mark=Markup(MARK),  # noqa: S704 (a constant)
        result=result,
        written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        verdict=_verdict(result),
        interval_text=_interval_text(result),
        warnings=_warnings(result),
        tables=tables,
        scores_figure=_figure(figures.score_bars("scores", {n: s.share for n, s in result.scores.items()})),
        not_learned=tables.not_learned(result.dataset),
        from_tip=tables.learned_from_tip(result.dataset),
        moments=moments,
        **_followed(result, runs),
        **_covered(result, runs),
        **_at_worst(result, moments),
        **_learned(result),
    )


def _figure(svg: str | None) -> Markup | None:
    # Made by `svg.draw`: matplotlib and the standard library escape all text in it.
    return None if svg is None else Markup(svg)  # noqa: S704


def _verdict(result: Result) -> str:
    network, before = result.scores[NETWORK], result.scores[NO_COMPENSATION]
    text = (
        f"On measurements that it was not trained on, the network leaves {percent(network.share)} of the tool tip's "
        f"deviation: {micrometres(network.rms_um)} of {micrometres(before.rms_um)}, root mean square over the working "
        f"volume, and {micrometres(network.worst_um)} at the worst moment."
    )
    best = best_baseline(result)
    if best is not None:
        text += f" The best baseline, {best}, leaves {percent(result.scores[best].share)}."
    return text


def _interval_text(result: Result) -> str:
    """Return how the 95 % interval did, in a sentence; nothing where the bundle has none."""
    if result.interval is None or not result.interval.count:
        return ""
    share, width = percent(result.interval.within), micrometres(result.interval.half_width_um)
    return (
        f"Of the tip's deviations in x, y and z on these measurements, {share} lie within the network's 95 % interval, "
        f"which allows {width} to either side on average."
    )


def _warnings(result: Result) -> list[str]:
    found = []
    best = best_baseline(result)
    if best is not None and result.scores[NETWORK].rms_um >= result.scores[best].rms_um:
        found.append(f"The network does not beat {best} on these measurements.")
    if result.scores[NETWORK].share >= 1.0:
        found.append("The network leaves more than no compensation does: do not use it.")
    if result.seen:
        found.append(
            "The figures are of a network without the left-out part. The one in the bundle was trained again on "
            "everything, so nothing is left to test it on; --test-runs keeps runs out of it."
        )
    if len(result.dataset.runs) == 1:
        found.append("There is one run only: what is left out shares its start and its day with what was trained on.")
    found += [f"{notice[0].upper()}{notice[1:]}" for notice in result.notices]
    missing = tables.not_learned(result.dataset)
    if missing:
        found.append(
            f"{len(missing)} of the machine's {len(result.dataset.machine.terms)} error terms were not measured; the "
            "network takes them as zero."
        )
    return found


def _followed(result: Result, runs: list[LeftOutRun]) -> dict[str, Any]:
    best = best_baseline(result)
    drawn = [
        (run, _figure(figures.follow_run(f"run{i}", run, best, legend=i == 0)))
        for i, run in enumerate(runs[:MOST_FIGURES])
    ]
    return {
        "followed": [
            {
                "name": run.name,
                "figure": figure,
                "before": micrometres(run.worst_um(NO_COMPENSATION)),
                "after": micrometres(run.worst_um(NETWORK)),
                "part": not run.left_out.all(),
                "at": run.at,
            }
            for run, figure in drawn
        ],
        "followed_at": list(dict.fromkeys(run.at for run, _ in drawn)),
        "not_drawn": len(runs) - len(drawn),
        "bands": any(run.allowed_um is not None for run, _ in drawn),
    }


def _covered(result: Result, runs: list[LeftOutRun]) -> dict[str, Any]:
    counts = column_counts(result.dataset)
    return {
        "coverage_figure": _figure(figures.coverage_chart("coverage", result.dataset, counts)),
        "places_figure": _figure(figures.tip_places("places", result.dataset)),
        "terms_table": tables.terms(result, runs, counts),
    }


def column_counts(dataset: DataSet) -> dict[str, Array]:
    """Return per term how often each of its columns was measured, over all runs."""
    times = sum(np.isfinite(run.values).sum(axis=0) for run in dataset.runs.values())
    return {term: np.asarray(times)[mine] for term, mine in columns_by_term(dataset.columns).items()}


def _at_worst(result: Result, moments: list[Moment]) -> dict[str, Any]:
    """Return the terms, measured and predicted, at the worst moment."""
    empty: dict[str, Any] = {"worst_figures": [], "worst_tables": [], "worst_at": ""}
    if result.making is None or not moments:
        return empty
    moment, predictor, dataset = moments[0], result.making.predictor, result.dataset
    run = moment.run.measured
    followed = predictor.follow(run.telemetry)
    if dataset.datum == "run-start":
        followed = followed - followed[0]
    coefficients = run.between(followed)[moment.row]
    drawn = [
        (axis, figures.motion_terms(f"at{axis}", dataset, axis, moment.run, moment.row, predictor.fields, coefficients))
        for axis in dataset.machine.axis_names
    ]
    return {
        "worst_figures": [(axis, _figure(svg)) for axis, svg in drawn if svg is not None],
        "worst_tables": [
            table
            for table in (
                tables.location_terms(result, moment, predictor.fields, coefficients),
                tables.tip_at_worst(moment, result.metric, dataset.machine),
            )
            if table is not None
        ],
        "worst_at": f"run {moment.run.name}, {clock(moment.time_s)} after power-on",
    }


def _learned(result: Result) -> dict[str, Any]:
    """Return how the network learned and what it found."""
    if result.making is None:
        return {"modes_figure": None, "residual_um": None, "curves_figure": None, "verdict_on_residual": None}
    making = result.making
    trained = result.bundle.manifest.training["runs"]
    weights = mode_weights(result.dataset, making.served, tables.sensor_model(result), trained)
    verdict = making.measured.verdict
    final = making.served.curves[-1] if verdict.keep and making.served.curves else None
    folds = making.measured.curves[:-1] if verdict.keep else making.measured.curves
    curves = figures.loss_curves("curves", folds, final) if folds or final else None
    return {
        "modes_figure": _figure(figures.mode_bars("modes", weights)),
        "residual_um": None if weights.residual_um is None else micrometres(weights.residual_um),
        "curves_figure": _figure(curves),
        "verdict_on_residual": {
            "keep": verdict.keep,
            "judged": bool(making.measured.curves),
            "linear": percent(verdict.left_linear, 2),
            "whole": percent(verdict.left_whole, 2),
        },
    }
