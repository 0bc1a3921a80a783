"""Measurements left out in turn, so that everything is judged by a network that has not seen it."""

from __future__ import annotations

import numpy as np

from model.exceptions import DataError
from training.baselines.parts import parts
from training.dataset import DataSet
from training.split import Split, everything

FOLDS = 5
"""Groups that many runs are left out in (chosen: leaving out fewer at a time takes longer and hardly differs)."""


def folds(dataset: DataSet) -> list[Split]:
    """Return divisions that together leave out everything: whole runs in turn, of a single run its spindle phases.

    Raises
    ------
    DataError
        where a single run cannot be divided.
    """
    names = list(dataset.runs)
    part = parts(dataset, everything(dataset))
    known = np.unique(np.concatenate(list(part.values())))
    if len(known) < 2:
        raise DataError(f"run '{names[0]}' of '{dataset.path}' cannot be divided in time; record more than one run")
    count = min(FOLDS, len(known)) if len(names) > 1 else len(known)
    found: list[Split] = []
    for k in range(count):
        out = {name: np.isin(number, known[k::count]) for name, number in part.items()}
        runs = [name for name, mask in out.items() if mask.any()]
        what = f"runs {', '.join(runs)}" if len(names) > 1 else f"part {k + 1} of {count}"
        found.append(Split({name: ~mask for name, mask in out.items()}, out, what))
    return found
