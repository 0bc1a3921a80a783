"""The linear decoder from whatever was measured, in closed form: the coefficients need not be known at any time.

The same regression as in `training/decoder.py`: coefficients are features times weights plus a residual that is a
first-order autoregressive process in time, weights and residual with one prior covariance of the coefficients. Where
every time shows all of them, the covariance cancels and that page's ridge regression is left. Where it shows only
rows of z (`training/information.py`), the residual is taken out of the rows by a smoother (the block form of Rauch,
Tung and Striebel, AIAA J. 3 (1965) 1445): with T the precision of the process and N that of the rows,

    (X' M X + λ) V = X' T (T + N)^-1 n,    M = T - T (T + N)^-1 T,

V being the weights of z, X the features and n the rows' vector. M is T where N is large (all known), and nothing
where N is zero. The equations are solved by conjugate gradients; the preconditioner is exact where each time shows
the same share of each direction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg

from model.exceptions import ComputeError
from model.transforms import Array
from training.information import Information

TOLERANCE = 1e-6
"""Residual of the equations beside their right-hand side."""
MOST_ITERATIONS = 2000


def solve_weights(x: Array, information: Information, keep: Array, run: NDArray[np.intp], damping: float) -> Array:
    """Return the weights V of the directions, shape (F, r).

    Parameters
    ----------
    x : features, shape (N, F), in time order within each run
    keep : correlation of the residual with the row before, shape (N,), 0 at the first of each run
    run : shape (N,), number of the run
    damping : λ

    Raises
    ------
    ComputeError
        where conjugate gradients do not converge.
    """
    process = Smoother(keep, run, information.precision)
    width, size = x.shape[1], information.vector.shape[1]

    def normal(flat: Array) -> Array:
        weights = flat.reshape(width, size)
        applied: Array = x.T @ process.information(x @ weights) + damping * weights
        return applied.ravel()

    # M is about T times the mean share of each direction that a time shows.
    spread, across = np.linalg.eigh(x.T @ process.precise(x))
    share, along = np.linalg.eigh(process.share())
    scale = np.maximum(spread, 0.0)[:, None] * np.clip(share, 0.0, 1.0) + damping

    def precondition(flat: Array) -> Array:
        weights = flat.reshape(width, size)
        solved: Array = across @ ((across.T @ weights @ along) / scale) @ along.T
        return solved.ravel()

    shape = (width * size, width * size)
    wanted = (x.T @ process.precise(process.smooth(information.vector))).ravel()
    found, problem = cg(
        LinearOperator(shape, matvec=normal, dtype=float),
        wanted,
        rtol=TOLERANCE,
        maxiter=MOST_ITERATIONS,
        M=LinearOperator(shape, matvec=precondition, dtype=float),
    )
    if problem or not np.isfinite(found).all():
        raise ComputeError("the decoder's equations must converge; look for extreme values in tool_tip")
    return np.asarray(found, dtype=float).reshape(width, size)


class Smoother:
    """The residual's process in all runs at once, and what the rows say about it.

    Parameters
    ----------
    keep : correlation with the row before, shape (N,), 0 at the first of each run
    run : shape (N,), number of the run
    precision : of the rows, shape (N, r, r)
    """

    def __init__(self, keep: Array, run: NDArray[np.intp], precision: Array) -> None:
        numbers, which, lengths = np.unique(run, return_inverse=True, return_counts=True)
        begin = np.concatenate([[0], np.cumsum(lengths)[:-1]])
        self._which, self._step = which.ravel(), np.arange(len(run)) - begin[which.ravel()]
        self._shape = (int(lengths.max()), len(numbers))
        self._keep = self._spread(keep)[..., None]
        self._scale = 1.0 / np.sqrt(1.0 - self._keep**2)
        self._mean_share = self._mean(precision)
        self._inverse = self._factor(self._spread(precision))

    def precise(self, rows: Array) -> Array:
        """Return T times rows (N, ...)."""
        return self._gather(self._precise(self._spread(rows)))

    def smooth(self, rows: Array) -> Array:
        """Return (T + N)^-1 times rows (N, r)."""
        return self._gather(self._smooth(self._spread(rows)))

    def information(self, rows: Array) -> Array:
        """Return M times rows (N, r)."""
        whitened = self._precise(self._spread(rows))
        return self._gather(whitened - self._precise(self._smooth(whitened)))

    def share(self) -> Array:
        """Return about what share of each direction a time shows, shape (r, r)."""
        return self._mean_share

    def _spread(self, rows: Array) -> Array:
        """Return rows (N, ...) as (steps, runs, ...), zero behind the end of a run."""
        spread = np.zeros((*self._shape, *rows.shape[1:]))
        spread[self._step, self._which] = rows
        return spread

    def _gather(self, spread: Array) -> Array:
        gathered: Array = spread[self._step, self._which]
        return gathered

    def _precise(self, z: Array) -> Array:
        """Return T z = W' W z, where W takes from each row what the one before lets expect."""
        white = z.copy()
        white[1:] -= self._keep[1:] * z[:-1]
        white *= self._scale**2
        white[:-1] -= self._keep[1:] * white[1:]
        return white

    def _factor(self, precision: Array) -> Array:
        """Return the inverse of each step's block of T + N when all steps before are eliminated."""
        eye = np.eye(precision.shape[-1])
        scale, after = self._scale**2, np.zeros_like(self._keep)
        after[:-1] = (self._keep[1:] * self._scale[1:]) ** 2
        inverse = np.empty_like(precision)
        for t in range(len(precision)):
            block = precision[t] + (scale[t] + after[t])[..., None] * eye
            if t:
                block = block - (self._link(t) ** 2)[..., None] * inverse[t - 1]
            inverse[t] = np.linalg.inv(block)
        return inverse

    def _link(self, t: int) -> Array:
        """Return minus the block of T between steps t - 1 and t, shape (runs, 1)."""
        link: Array = self._keep[t] * self._scale[t] ** 2
        return link

    def _smooth(self, z: Array) -> Array:
        forward = np.empty_like(z)
        for t in range(len(z)):
            forward[t] = z[t]
            if t:
                forward[t] += self._link(t) * forward[t - 1]
            forward[t] = (self._inverse[t] @ forward[t][..., None])[..., 0]
        for t in range(len(z) - 2, -1, -1):
            forward[t] += (self._inverse[t] @ (self._link(t + 1) * forward[t + 1])[..., None])[..., 0]
        return forward

    def _mean(self, precision: Array) -> Array:
        level = float(self._gather(self._scale).ravel().mean() ** 2)
        eye = np.eye(precision.shape[-1])
        mean: Array = eye - level * np.linalg.inv(precision + level * eye).mean(axis=0)
        return (mean + mean.T) / 2.0
