"""The linear decoder in closed form: generalised ridge regression on the thermal modes.

Here the coefficients of the fields are known; where the tip was measured instead, see `training/tip_decoder.py`.

What the modes cannot explain is correlated over time, so neighbouring measurements say little anew. Rows are
whitened as a first-order autoregressive process (Cochrane and Orcutt, J. Am. Stat. Assoc. 44 (1949) 32; Prais and
Winsten, 1954), and the penalty is set against the number of independent measurements that remains. So the decoder
does not depend on how often somebody measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from model.transforms import Array
from training.labels import patterns
from training.samples import Samples
from training.tip_decoder import solve_weights

BIAS_SIZE = 1.0
"""Prior size of the constant part of absolute deviations, beside one typical temperature swing (chosen)."""


@dataclass(frozen=True)
class Whitening:
    """Turns residuals that are correlated in time into independent ones of the same variance.

    Attributes
    ----------
    keep : shape (N,), correlation with the row before, 0 at the first of each run
    effective : number of independent rows
    """

    keep: Array
    effective: float

    @classmethod
    def of(cls, samples: Samples, correlation_s: float) -> Whitening:
        """Return the whitening of rows in time order within each run."""
        keep = kept(samples.time_s, samples.run, correlation_s)
        return cls(keep, float(((1.0 - keep) / (1.0 + keep)).sum()))

    def apply(self, rows: Array) -> Array:
        """Return whitened rows (N, ...)."""
        before = np.concatenate([np.zeros_like(rows[:1]), rows[:-1]])
        keep = self.keep[:, None]
        whitened: Array = (rows - keep * before) / np.sqrt(1.0 - keep**2)
        return whitened


def kept(time_s: Array, run: NDArray[np.intp], correlation_s: float) -> Array:
    """Return the correlation of each row with the one before, shape (N,), 0 at the first of each run."""
    gap = np.diff(time_s)
    same = np.diff(run) == 0
    return np.concatenate([[0.0], np.where(same, np.exp(-np.where(same, gap, 0.0) / correlation_s), 0.0)])


@dataclass(frozen=True)
class Normal:
    """The normal equations of the linear decoder, from which it follows for any penalty and any sizes of the features.

    Attributes
    ----------
    parts : per set of coefficients that were measured at the same times: X'X / n of shape (F + 1, F + 1), X'Y / n of
        shape (F + 1, P'), which coefficients; n independent rows, the last column of X is constant
    width, outputs : F and P
    constant : value of the last column, 0 without a bias
    """

    parts: list[tuple[Array, Array, NDArray[np.intp]]]
    width: int
    outputs: int
    constant: float

    @classmethod
    def of(cls, samples: Samples, correlation_s: float, *, bias: bool) -> Normal:
        """Return them for measured coefficients; arguments as of `solve_decoder`."""
        constant = BIAS_SIZE if bias else 0.0
        features = with_constant(samples, constant)
        parts = []
        for rows, columns in patterns(np.isfinite(samples.targets)):
            if not rows.any():
                continue
            whitening = Whitening.of(samples.where(rows), correlation_s)
            x = whitening.apply(features[rows])
            y = whitening.apply(samples.targets[np.ix_(rows, columns)])
            parts.append((x.T @ x / whitening.effective, x.T @ y / whitening.effective, columns))
        return cls(parts, samples.features.shape[1], samples.targets.shape[1], constant)

    def solve(self, ridge: float, sizes: Array | None = None) -> tuple[Array, Array]:
        """Return the weights (F, P) and the bias (P,); zero where a coefficient was never seen.

        Parameters
        ----------
        ridge : as of `solve_decoder`
        sizes : shape (F,): the penalty is that of weights of the features times these; the weights returned are of
            the features themselves
        """
        found: Array = np.zeros((self.width + 1, self.outputs))
        for square, product, columns in self.parts:
            scale = np.ones((len(square), 1))
            if sizes is not None:
                scale[:-1, 0] = sizes
            normal = scale * square * scale.T + ridge * np.eye(len(square))
            found[:, columns] = scale * cho_solve(cho_factor(normal), scale * product)
        return found[:-1], found[-1] * self.constant


def with_constant(samples: Samples, constant: float) -> Array:
    """Return the features and one more that is constant, shape (N, F + 1)."""
    return np.concatenate([samples.features, np.full((len(samples.features), 1), constant)], axis=1)


def solve_decoder(samples: Samples, *, ridge: float, correlation_s: float, bias: bool) -> tuple[Array, Array]:
    """Return the weights (F, P) and the bias (P,) of the linear decoder; zero where a coefficient was never seen.

    Parameters
    ----------
    ridge : penalty of a squared weight, beside the *mean* square of what the independent rows leave: it is added to
        X'X / (their number). A noise variance over a prior variance would be added to X'X itself and fade as
        measurements add up; this does not, since what the modes cannot say is no noise that averages out
    correlation_s : time over which what is left is correlated [s]
    bias : whether the deviations have an absolute zero that may differ from the network's
    """
    weights, shift = Normal.of(samples, correlation_s, bias=bias).solve(ridge)
    if samples.information is not None:
        constant = BIAS_SIZE if bias else 0.0
        whitening = Whitening.of(samples, correlation_s)
        known, damping = samples.information, ridge * whitening.effective
        seen = solve_weights(with_constant(samples, constant), known, whitening.keep, samples.run, damping)
        # What the tip does not see, only terms that were measured themselves can say.
        found = np.concatenate([weights, shift[None] / (constant or 1.0)])
        found = known.directions.coefficients(seen) + known.directions.unseen(found)
        weights, shift = found[:-1], found[-1] * constant
    return weights, shift
