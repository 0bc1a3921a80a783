"""Is a data set in the units that it should be in? A thousand times too large or too small is a unit, not a machine.

Machines that were published, and those of the synthetic shop, move by 1 to 10 µm for each kelvin that their sensors
swing. The bounds below are a hundred times and more beyond that.
"""

from __future__ import annotations

import numpy as np

from model.exceptions import DataError
from model.transforms import Array
from training.coverage import columns_by_term
from training.dataset import DataSet, MeasuredRun
from training.tip import TipMetric

UM_PER_K = (0.02, 1000.0)
"""The tip's largest deviation beside the sensors' largest swing; less or more is another unit (chosen)."""
RATIO = 100.0
"""Between one run and the others, or between terms and tip (chosen: between mm and µm there are 1000)."""
FAINT = 0.3
"""Terms that never reach it [µm, µrad] beside others that move the tip by `RATIO` times what they do are mm or rad."""
FAINT_COLD = 0.05
"""Cold errors that never reach it [µm, µrad] are nobody's (chosen)."""
SWING_K = 1.0
"""Less swing says nothing of a machine."""
WARMEST_DEGC = 50.0
"""Somewhere on the machine it is colder than this at some time (chosen); a room in °F never is."""
KELVIN = (230.0, 420.0)
STEP_S, LONG_STEP_S, LONG_S, SHORT_S = 3600.0, 900.0, 20 * 86400.0, 60.0
"""Telemetry further apart, or so far apart over so long, is in ms; a longest run this short is in hours (chosen)."""


def check_plausible(dataset: DataSet, metric: TipMetric) -> None:
    """Check units as far as numbers tell them.

    Raises
    ------
    DataError
        with what is odd, where, and which unit it may be.
    """
    _check_times(dataset)
    _check_temperatures(dataset)
    _check_cold(dataset)
    _check_parts(dataset, metric)
    _check_sensitivity(dataset, metric)


def notices(dataset: DataSet) -> list[str]:
    """Return what looks odd and does no harm to the training, a sentence each."""
    found = []
    if dataset.unmeasured:
        found.append(f"runs without a measurement are left aside: {', '.join(dataset.unmeasured)}")
    for i, sensor in enumerate(dataset.sensors):
        column = np.concatenate([run.telemetry.temperatures[:, i] for run in dataset.runs.values()])
        if np.nanmax(column) == np.nanmin(column):
            found.append(f"sensor '{sensor}' reads {np.nanmax(column):g} °C throughout; is it stuck?")
    if len(dataset.sensors) < 3:
        return found
    firsts = np.array([_first(run.telemetry.temperatures) for run in dataset.runs.values()])  # (R, S)
    for i, sensor in enumerate(dataset.sensors):
        others = np.median(np.delete(firsts, i, axis=1), axis=1)
        off, as_fahrenheit = firsts[:, i] - others, (firsts[:, i] - 32.0) / 1.8 - others
        if (off > 25.0).all() and np.abs(as_fahrenheit).max() < 5.0:
            found.append(f"sensor '{sensor}' is {off.min():.0f} K above the others at each run's start; is it in °F?")
    return found


def _first(temperatures: Array) -> Array:
    """Return each sensor's first reading."""
    row = np.argmax(np.isfinite(temperatures), axis=0)
    first: Array = temperatures[row, np.arange(temperatures.shape[1])]
    return first


def _check_times(dataset: DataSet) -> None:
    where = f"data set '{dataset.path}'"
    longest = 0.0
    for name, run in dataset.runs.items():
        time_s = run.telemetry.time_s
        length = float(np.ptp(time_s))
        longest = max(longest, length)
        step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
        if step > STEP_S or (step > LONG_STEP_S and length > LONG_S):
            raise DataError(
                f"{where}: time_s must be in seconds, got telemetry of run '{name}' with {step / 3600.0:.2g} h between "
                f"two rows over {length / 86400.0:.0f} days; if it is in milliseconds, divide it by 1000"
            )
        spanned = float(np.ptp(run.time_s))
        if len(run.time_s) >= 5 and spanned * 300.0 < length:
            raise DataError(
                f"{where}: measurements of run '{name}' must span its telemetry, got {len(run.time_s)} within "
                f"{spanned:.3g} s of {length:.3g} s; give both times in seconds"
            )
    if longest < SHORT_S:
        raise DataError(
            f"{where}: time_s must be in seconds and runs last minutes to days, got {longest:.3g} s as the longest "
            "run; if it is in hours, multiply it by 3600"
        )


def _check_temperatures(dataset: DataSet) -> None:
    where, swing = f"data set '{dataset.path}'", 0.0
    for name, run in dataset.runs.items():
        temperatures = run.telemetry.temperatures
        for i, sensor in enumerate(dataset.sensors):
            low, high = dataset.machine.sensors[sensor].range_degC
            median = float(np.nanmedian(temperatures[:, i]))
            if not low <= median <= high:
                hint = "it may be in kelvin: subtract 273.15" if KELVIN[0] < median < KELVIN[1] else (
                    "look at its cable and unit, leave wrong cells empty, or set range_degC in machine.toml"
                )  # fmt: skip
                raise DataError(
                    f"{where}: sensor '{sensor}' must read {low:g} to {high:g} °C (machine.toml), got {median:.4g} as "
                    f"the median of run '{name}'; {hint}"
                )
        if np.nanmin(temperatures) > WARMEST_DEGC:
            raise DataError(
                f"{where}: temperatures must be in °C, got none below {np.nanmin(temperatures):.4g} in run '{name}'; "
                "if they are in °F, convert them: (F - 32) / 1.8"
            )
    for i in range(len(dataset.sensors)):
        column = np.concatenate([run.telemetry.temperatures[:, i] for run in dataset.runs.values()])
        swing = max(swing, float(np.nanmax(column) - np.nanmin(column)))
    if swing == 0.0:
        raise DataError(
            f"{where}: temperatures must change, got constant readings of all {len(dataset.sensors)} sensors; look at "
            "the logger"
        )


def _check_cold(dataset: DataSet) -> None:
    largest = max((abs(value) for _, _, value in dataset.geometry), default=0.0)
    if 0.0 < largest < FAINT_COLD:
        raise DataError(
            f"data set '{dataset.path}': geometry must be in µm and µrad, got {largest:.2g} as the largest value; if "
            "it is in mm or rad, multiply it"
        )


def _check_parts(dataset: DataSet, metric: TipMetric) -> None:
    """Compare shifts with turns, and terms with the tip: all in one unit, or in units that do not agree."""
    shift = [n for n in dataset.measured_terms if not dataset.machine.term(n).angular]
    turn = [n for n in dataset.measured_terms if dataset.machine.term(n).angular]
    columns = columns_by_term(dataset.columns)
    for names, others, unit, wrong in ((shift, turn, "µm", "mm"), (turn, shift, "µrad", "rad")):
        mine = np.concatenate([columns[n] for n in names]) if names else np.zeros(0, dtype=int)
        largest = max((_largest(run.values[:, mine]) for run in dataset.runs.values()), default=0.0)
        if not 0.0 < largest < FAINT:
            continue
        if _moved(dataset, metric, others) > RATIO * _moved(dataset, metric, names):
            some = ", ".join(names[:4]) + (" ..." if len(names) > 4 else "")
            raise DataError(
                f"data set '{dataset.path}': error_terms must be in µm and µrad, got {largest:.2g} {unit} as the "
                f"largest of {some}; if these are in {wrong}, multiply them"
            )
    if not dataset.places or not dataset.measured_terms or not metric.complete:
        return
    tip = max(_largest(run.values[:, len(dataset.columns) :]) for run in dataset.runs.values())
    terms = _moved(dataset, metric, list(dataset.measured_terms))
    if tip > 0.0 and terms > 0.0 and not 1.0 / RATIO < tip / terms < RATIO:
        raise DataError(
            f"data set '{dataset.path}': error_terms and tool_tip must be in µm and µrad, got terms that move the tip "
            f"by {terms:.2g} µm and a tip that moves by {tip:.2g} µm; look at their units"
        )


def _largest(values: Array) -> float:
    return float(np.nanmax(np.abs(values), initial=0.0)) if np.isfinite(values).any() else 0.0


def _moved(dataset: DataSet, metric: TipMetric, names: list[str]) -> float:
    """Return how far some terms alone move the tip at most, root mean square over the volume [µm]."""
    slices, most = metric.slices(), 0.0
    for run in dataset.runs.values():
        sampled = metric.sample(run.values)
        only = np.full_like(sampled, np.nan)
        for name in names:
            only[:, slices[name]] = sampled[:, slices[name]]
        most = max(most, float(np.sqrt(metric.mean_square(only).max())))
    return most


def _check_sensitivity(dataset: DataSet, metric: TipMetric) -> None:
    found: dict[str, float] = {}
    for name, run in dataset.runs.items():
        swing = _swing(run)
        if swing >= SWING_K:
            found[name] = float(np.sqrt(metric.mean_square(metric.sample(run.values)).max())) / swing
    moving = {name: value for name, value in found.items() if value > 0.0}
    if not moving:
        return
    where = f"data set '{dataset.path}'"
    most = max(moving.values())
    if not UM_PER_K[0] <= most <= UM_PER_K[1]:
        raise DataError(
            f"{where}: error_terms and tool_tip must be in µm and µrad, got a tool tip that moves by {most:.2g} µm per "
            f"kelvin at most, where machines move by 1 to 10; "
            f"{'convert mm and rad' if most < 1.0 else 'convert nm, and take out what is no measurement'}"
        )
    usual = float(np.median(list(moving.values())))
    for name, value in moving.items():
        if len(moving) > 2 and not 1.0 / RATIO < value / usual < RATIO:
            raise DataError(
                f"{where}: all runs must be in the same units, got a tool tip that moves by {value:.2g} µm per kelvin "
                f"in run '{name}' and by {usual:.2g} in the others; look at the units of that run"
            )


def _swing(run: MeasuredRun) -> float:
    temperatures = run.telemetry.temperatures
    return float(np.max(np.nanmax(temperatures, axis=0) - np.nanmin(temperatures, axis=0)))
