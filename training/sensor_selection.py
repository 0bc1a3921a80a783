"""What each sensor is worth, and which few of them do nearly as well as all.

Every set is judged by what it leaves at the tip on measurements that are left out in turn (`sensor_sets.SetJudge`).
Three greedy searches look for small ones: by the drift, taking away one sensor at a time and adding one at a time; and
by the temperatures alone, taking away the sensor that the others tell best. The first two are no search of all sets,
but of `fe_a` and `vmc3`, whose sets were all tried, they miss the best of a size by 1 % or less from three sensors on.

A set found among hundreds owes something to luck on the very measurements that it was chosen by. So the searches by
the drift are done again without each left-out part, and judged on that part alone. What counts for each size is the
search that leaves less then; that by the temperatures has seen no drift and needs no such check. With many runs the
drift chooses better, with a single run of few phases the temperatures do.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from model.exceptions import DataError
from model.progress import Reporter
from model.transforms import Array
from training.sensor_likeness import Chosen, alike, told_best
from training.sensor_sets import Inputs, SetJudge
from training.split import Split

ENOUGH_FOLDS = 3
"""Parts needed to choose without one of them: of two, the other alone would have to both train and judge."""

By = Literal["drift", "temperatures"]


@dataclass(frozen=True)
class Worth:
    """What one input is worth.

    Attributes
    ----------
    without_um : left at the tip when it alone is taken away [µm]
    alone_um : left when it alone is kept: a sensor beside all channels, a channel without any sensor [µm]
    """

    name: str
    without_um: float
    alone_um: float


@dataclass(frozen=True)
class Size:
    """The best set found of one size.

    Attributes
    ----------
    by : what the search went by
    left_um : left at the tip by this set [µm]; by the drift, it was chosen for it
    fair_um : left by sets that the same search found without the measurements that they are judged on [µm]; None for
        the drift's with too few runs
    """

    sensors: tuple[str, ...]
    by: By
    left_um: float
    fair_um: float | None


@dataclass(frozen=True)
class Step:
    """A step of a search: the sensor taken away or added, and what is left after it [µm]."""

    sensor: str
    left_um: float


@dataclass(frozen=True)
class Group:
    """Sensors that rise and fall together.

    Attributes
    ----------
    correlation : within runs, the lowest between two of them
    without_um : left at the tip when all of them are taken away [µm]
    """

    sensors: tuple[str, ...]
    correlation: float
    without_um: float


@dataclass(frozen=True)
class Selection:
    """What the inputs of a data set are worth; all figures on measurements left out in turn [µm].

    Attributes
    ----------
    drift_um : without compensation
    all_um, channels_um, sensors_um, nothing_um : left with all inputs, with the channels alone, with the sensors
        alone, and with neither; the last knows a constant at most
    sizes : from no sensor to all
    backward, forward, told : the searches, step by step
    loss : how much more than with all sensors may be left, as a share
    best : the smallest size from which on all are within the loss
    instead : for each of its sensors, others that could take its place within the loss
    """

    drift_um: float
    all_um: float
    channels_um: float
    sensors_um: float
    nothing_um: float
    sensors: tuple[Worth, ...]
    channels: tuple[Worth, ...]
    groups: tuple[Group, ...]
    sizes: tuple[Size, ...]
    backward: tuple[Step, ...]
    forward: tuple[Step, ...]
    told: tuple[Step, ...]
    loss: float
    best: Size
    instead: dict[str, tuple[str, ...]]

    def more(self, left_um: float) -> float:
        """Return how much more is left than with all inputs, as a share."""
        return left_um / self.all_um - 1.0


def select(inputs: Inputs, splits: list[Split], loss: float) -> Selection:
    """Judge the sensors and channels of a data set.

    Parameters
    ----------
    splits : what is left out in turn
    loss : how much more than all sensors the small set may leave, as a share

    Raises
    ------
    DataError
        where nothing that is left out shows any drift.
    """
    dataset = inputs.dataset
    names, channels = dataset.sensors, range(len(dataset.channels))
    judge = _Judge(inputs, splits)
    if not judge.sets.drift_um > 0.0:
        raise DataError(f"data set '{dataset.path}' must have measurements in which the tool tip moves, got none")
    again = splits if len(splits) >= ENOUGH_FOLDS else []
    with Reporter("judging sets of sensors", 2 * len(names) * (1 + len(again))) as reporter:
        backward, forward, found = judge.search(reporter)
        fair_um = _fair_um(inputs, again, reporter) if again else [None] * len(found)
    told = told_best(list(inputs.readings.values()))
    sets = [_better(judge, *both) for both in zip(found, fair_um, _by_size(told), strict=True)]
    sizes = tuple(Size(_named(names, s.chosen), s.by, judge(s.chosen), s.fair_um) for s in sets)
    everything = judge.everything
    size = _smallest(sizes, loss)
    best = sets[size].chosen
    limit = max((1.0 + loss) * judge(everything), judge(best))
    instead = {
        names[i]: _named(names, (j for j in everything - best if judge((best - {i}) | {j}) <= limit))
        for i in sorted(best)
    }
    return Selection(
        drift_um=judge.sets.drift_um,
        all_um=judge(everything),
        channels_um=judge(frozenset()),
        sensors_um=judge.sets.residual_um(everything, []),
        nothing_um=judge.sets.residual_um([], []),
        sensors=tuple(Worth(n, judge(everything - {i}), judge(frozenset([i]))) for i, n in enumerate(names)),
        channels=tuple(
            Worth(
                dataset.channels[c],
                judge.sets.residual_um(everything, [other for other in channels if other != c]),
                judge.sets.residual_um([], [c]),
            )
            for c in channels
        ),
        groups=tuple(
            Group(_named(names, group), lowest, judge(everything - group))
            for group, lowest in alike(list(inputs.readings.values()))
        ),
        sizes=sizes,
        backward=tuple(Step(names[i], judge(chosen)) for i, chosen in backward),
        forward=tuple(Step(names[i], judge(chosen)) for i, chosen in forward),
        told=tuple(Step(names[i], judge(chosen)) for i, chosen in told),
        loss=loss,
        best=sizes[size],
        instead=instead,
    )


class _Judge:
    """Judges sets of sensors beside all channels, each once."""

    def __init__(self, inputs: Inputs, splits: list[Split]) -> None:
        self.everything: Chosen = frozenset(range(len(inputs.dataset.sensors)))
        self.sets = SetJudge(inputs, splits)
        self._channels = range(len(inputs.dataset.channels))
        self._known: dict[Chosen, float] = {}

    def __call__(self, chosen: Chosen) -> float:
        if chosen not in self._known:
            self._known[chosen] = self.sets.residual_um(chosen, self._channels)
        return self._known[chosen]

    def search(self, reporter: Reporter) -> tuple[list[tuple[int, Chosen]], list[tuple[int, Chosen]], list[Chosen]]:
        """Return the steps backward and forward, and the better of both for each size from 0 on."""
        backward: list[tuple[int, Chosen]] = []
        forward: list[tuple[int, Chosen]] = []
        left, kept = self.everything, frozenset[int]()
        by_size: list[list[Chosen]] = [[] for _ in range(len(left) + 1)]
        by_size[0].append(kept)
        by_size[-1].append(left)
        for _ in range(len(self.everything)):
            out = min(sorted(left), key=lambda i: self(left - {i}))
            left = left - {out}
            backward.append((out, left))
            by_size[len(left)].append(left)
            reporter.advance()
            taken = min(sorted(self.everything - kept), key=lambda i: self(kept | {i}))
            kept = kept | {taken}
            forward.append((taken, kept))
            by_size[len(kept)].append(kept)
            reporter.advance()
        return backward, forward, [min(sets, key=lambda chosen: (self(chosen), sorted(chosen))) for sets in by_size]


def _fair_um(inputs: Inputs, splits: list[Split], reporter: Reporter) -> list[float | None]:
    """Return what is left by size, each part judged by sets that were chosen, and trained, without it."""
    channels = range(len(inputs.dataset.channels))
    squares: list[list[Array]] = []
    for left_out in splits:
        inner = [
            Split({run: left_out.train[run] & mask for run, mask in other.train.items()}, other.test, other.description)
            for other in splits
            if other is not left_out
        ]
        _, _, found = _Judge(inputs, inner).search(reporter)
        outer = SetJudge(inputs, [left_out])
        squares.append([outer.squares_um2(chosen, channels) for chosen in found])
    return [float(np.sqrt(np.concatenate(parts).mean())) for parts in zip(*squares, strict=True)]


@dataclass(frozen=True)
class _Found:
    chosen: Chosen
    by: By
    fair_um: float | None


def _better(judge: _Judge, by_drift: Chosen, fair_um: float | None, by_temperatures: Chosen) -> _Found:
    """Return the set whose search leaves less where it is judged fairly; with too few runs for that, the drift's."""
    blind_um = judge(by_temperatures)
    if by_drift == by_temperatures:
        return _Found(by_drift, "temperatures", blind_um)
    if fair_um is not None and blind_um < fair_um:
        return _Found(by_temperatures, "temperatures", blind_um)
    return _Found(by_drift, "drift", fair_um)


def _by_size(steps: list[tuple[int, Chosen]]) -> list[Chosen]:
    """Return the sets of a backward search by size, from no sensor to all."""
    return [*(chosen for _, chosen in reversed(steps)), frozenset(out for out, _ in steps)]


def _smallest(sizes: tuple[Size, ...], loss: float) -> int:
    """Return the smallest size from which on all sets are within the loss; a single lucky one does not count."""
    left = [size.left_um if size.fair_um is None else size.fair_um for size in sizes]
    too_much = [k for k, um in enumerate(left) if um > (1.0 + loss) * left[-1]]
    return too_much[-1] + 1 if too_much else 0


def _named(names: tuple[str, ...], chosen: Iterable[int]) -> tuple[str, ...]:
    return tuple(names[i] for i in sorted(chosen))
