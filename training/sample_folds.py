"""Parts of the training samples, left out in turn to choose what a network is made with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from training.samples import Samples


def sample_folds(samples: Samples, count: int) -> list[NDArray[np.bool_]]:
    """Return which samples are inside for each fold: whole runs are left out, of a single run stretches of time."""
    runs = np.unique(samples.run)
    if len(runs) == 1:
        part = np.arange(len(samples.run)) * count // len(samples.run)
    else:
        part = np.searchsorted(runs, samples.run) % count
    return [part != k for k in np.unique(part)] if len(np.unique(part)) > 1 else []
