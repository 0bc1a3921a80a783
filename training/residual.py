"""The nonlinear residual: what a small network can add to the linear decoder, where left-out data says it helps."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from model.exceptions import ComputeError
from model.network import Residual
from model.progress import Reporter
from model.transforms import Array
from training.decoder import Whitening
from training.samples import Samples

DIRECTIONS_IN, DIRECTIONS_OUT = 8, 8
"""It looks at the directions of the features that the linear decoder finds most important, and moves the directions
of the coefficients in which the tip drifts most: a few numbers each, since the data is little."""


def fit_residual(
    samples: Samples,
    linear: Array,
    bias: Array,
    form: Array,
    *,
    hidden: int,
    steps: int,
    learning_rate: float,
    weight_decay: float,
    correlation_s: float,
    seed: int,
    reporter: Reporter,
    curve: list[float],
) -> Residual | None:
    """Return a residual fitted to what the linear decoder leaves, or None where too little was measured.

    Parameters
    ----------
    linear, bias : the linear decoder, shapes (F, P) and (P,)
    form : shape (P, P), the tip's mean square as a quadratic form of the coefficients
    steps : of the optimiser, each over all samples
    reporter : counts the steps
    curve : takes the share of the linear decoder's residual that is left, step by step (root mean square)
    """
    whole = samples.where(np.asarray(np.isfinite(samples.targets).all(axis=1)))
    directions = _directions(whole, linear, form)
    if directions is None:
        for _ in range(steps):
            reporter.advance()
        return None
    down, up, goal_of = directions
    whitening = Whitening.of(whole, correlation_s)
    goal = whitening.apply((whole.targets - whole.features @ linear - bias) @ goal_of)
    unit = float(goal.std()) or 1.0
    torch.manual_seed(seed)
    residual = Residual(torch.tensor(down), torch.tensor(up) * unit, hidden)
    now = torch.tensor((whole.features + whole.first) @ down)
    first = torch.tensor(whole.first @ down)
    relative = bool(np.any(whole.first))
    wanted, keep = torch.tensor(goal / unit), torch.tensor(whitening.keep)[:, None]
    optimiser = torch.optim.AdamW(residual.parameters(), lr=learning_rate, weight_decay=weight_decay)
    loss_of = nn.MSELoss()

    def said(at: torch.Tensor) -> torch.Tensor:
        answer: torch.Tensor = residual.leave(torch.tanh(residual.enter(at)))
        return answer

    for _ in range(steps):
        optimiser.zero_grad()
        out = said(now) - said(first) if relative else said(now)
        before = torch.cat([torch.zeros_like(out[:1]), out[:-1]])
        loss = loss_of((out - keep * before) / torch.sqrt(1.0 - keep**2), wanted)
        loss.backward()
        optimiser.step()
        curve.append(float(loss.detach()) ** 0.5)
        if not np.isfinite(curve[-1]):
            raise ComputeError(
                f"the loss must be finite, got {curve[-1]} at step {len(curve)} of the nonlinear residual; look for "
                "extreme values in the data set"
            )
        reporter.advance(f"left of the linear decoder's residual {curve[-1]:.0%}")
    return residual


def _directions(samples: Samples, linear: Array, form: Array) -> tuple[Array, Array, Array] | None:
    """Return `down` (F, D), `up` (E, P), and the matrix (P, E) that reads the coefficients in the `up` directions."""
    if len(samples.features) < 100:  # fewer cannot teach a few hundred weights anything
        return None
    values, vectors = np.linalg.eigh(form)
    half = vectors * np.sqrt(np.maximum(values, 0.0))  # c @ half has the tip's metric
    seen = half[:, values > 1e-9 * values.max()]
    important = np.linalg.svd(linear @ seen, full_matrices=False)[0][:, :DIRECTIONS_IN]
    spread = (samples.features @ important).std(axis=0)
    important, spread = important[:, spread > 0], spread[spread > 0]
    drift = np.linalg.svd(samples.targets @ seen, full_matrices=False)[2][:DIRECTIONS_OUT]  # (E, R)
    if not important.size or not drift.size:
        return None
    return important / spread, drift @ np.linalg.pinv(seen), seen @ drift.T
