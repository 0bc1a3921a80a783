"""The picture of a test run: true and predicted tool-tip deviation over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np

from model.exceptions import DataError
from training.dataset import DataSet
from training.evaluation import NETWORK, RIDGE, Method
from training.split import Mask
from training.tip import TipMetric

STYLES = {NETWORK: {"color": "#0b6e4f", "lw": 1.8}, RIDGE: {"color": "#d1495b", "lw": 1.2, "ls": "--"}}


FORMATS = (".png", ".svg", ".pdf")


def check_picture(path: Path) -> None:
    """Check that a picture could be drawn, before the work that it is to show.

    Raises
    ------
    DataError
        where its folder does not exist, it is a folder itself, or its ending is not a picture's.
    """
    if path.suffix.lower() not in FORMATS:
        raise DataError(f"picture '{path}' must end in {', '.join(FORMATS)}, got '{path.suffix}'")
    if not path.parent.is_dir():
        raise DataError(f"picture '{path}' must be in a folder that exists, got '{path.parent}'; make it first")
    if path.is_dir():
        raise DataError(f"picture '{path}' must be a file, got a folder")


def draw_test_run(
    path: str | Path,
    dataset: DataSet,
    run_name: str,
    tested: Mask,
    methods: Mapping[str, Method],
    metric: TipMetric,
) -> None:
    """Draw the deviation in x, y and z at the middle of the working volume, and what each method leaves of it.

    Where the tip was measured instead of terms, the mean over the positions of each time.

    Where only part of the run was left out, that part is shaded.
    """
    matplotlib.use("Agg")
    from matplotlib import pyplot  # noqa: PLC0415 (after the backend is chosen)

    run = dataset.runs[run_name]
    machine = dataset.machine
    centre = np.array([(machine.axes[a].low + machine.axes[a].high) / 2 for a in machine.axis_names])
    point = int(np.argmin(np.linalg.norm(metric.positions - centre, axis=1)))
    hours = run.time_s / 3600.0
    truth = metric.sample(run.values)
    gaps = np.where(metric.whole(truth).any() & ~metric.whole(truth), np.nan, 1.0)  # where not all terms are shown
    said = {name: np.where(np.isfinite(truth), method(run), np.nan) for name, method in methods.items()}
    true = metric.deviation(truth)[:, point] * gaps[:, None]
    predicted = {name: metric.deviation(terms)[:, point] * gaps[:, None] for name, terms in said.items()}
    figure, axes = pyplot.subplots(4, 1, figsize=(9, 9), sharex=True, constrained_layout=True)
    for d, axis in enumerate(axes[:3]):
        axis.plot(hours, true[:, d], color="black", lw=2.4, label="true")
        for name, deviation in predicted.items():
            axis.plot(hours, deviation[:, d], label=name, **STYLES.get(name, {}))
        axis.set_ylabel(f"deviation {'xyz'[d]} [µm]")
        axis.grid(alpha=0.3)
    axes[0].legend(loc="best", ncols=3, frameon=False)
    at = ", ".join(f"{a} {v:.0f}" for a, v in zip(machine.axis_names, metric.positions[point], strict=True))
    where = "mean over the measured positions" if metric.places and not metric.complete else f"at {at} mm"
    axes[0].set_title(f"{machine.name}, left-out run {run_name}, tool tip {where}", loc="left")
    axes[3].plot(hours, np.sqrt(metric.mean_square(truth)) * gaps, color="black", lw=2.4, label="no compensation")
    for name, terms in said.items():
        left = np.sqrt(metric.mean_square(truth - terms))
        axes[3].plot(hours, left * gaps, label=name, **STYLES.get(name, {}))
    if not tested.all():
        for axis in axes:
            axis.axvspan(hours[tested][0], hours[tested][-1], color="#f2e8cf", zorder=0)
    axes[3].set_ylabel("residual, RMS over\nthe volume [µm]")
    axes[3].set_xlabel("time since power-on [h]")
    axes[3].grid(alpha=0.3)
    figure.savefig(path, dpi=100)
    pyplot.close(figure)
