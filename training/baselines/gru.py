"""A recurrent network (gated recurrent unit) on temperatures and channels."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from model.transforms import Array
from training.baselines.clocked import clock, read, training_runs
from training.baselines.protocol import Task
from training.dataset import MeasuredRun

STEP_S = 600.0
"""Of its clock [s]: the state must reach over hours, and a hundred steps are easier than a thousand (chosen)."""
HIDDEN = (8, 24)
"""Candidate widths."""
FOLDS = 4
"""Networks: each stops early on another group of left-out parts, and their mean predicts."""
JUDGES = 2
"""Of these groups, the first so many choose the width (chosen: it matters little, and each costs a training)."""
STEPS, PATIENCE, CHECK = 400, 80, 5
"""Steps of the optimiser at most, without improvement, and between two looks at the left-out part (chosen)."""
LEARNING_RATE, WEIGHT_DECAY = 1e-2, 1e-3
"""Of AdamW (chosen)."""


class Recurrent(nn.Module):
    """Inputs (B, K, I) to scores of size 1 (B, K, R)."""

    def __init__(self, inputs: int, hidden: int, scores: int) -> None:
        super().__init__()
        self.cell = nn.GRU(inputs, hidden, batch_first=True)
        self.leave = nn.Linear(hidden + inputs, scores)

    def forward(self, inputs: Tensor) -> Tensor:
        """Return the scores; the inputs' immediate effect passes the recurrence by."""
        state, _ = self.cell(inputs)
        scores: Tensor = self.leave(torch.cat([state, inputs], dim=-1))
        return scores


@dataclass(frozen=True)
class GRU:
    """Networks whose mean predicts.

    Attributes
    ----------
    unit : what scores of size 1 are [µm at the tip]
    """

    task: Task
    networks: list[Recurrent]
    unit: float
    settings: dict[str, Any]

    def predict(self, run: MeasuredRun) -> Array:
        """Return the terms of a run on the metric's grid, shape (N, G) [µm, µrad]."""
        time_s, drive = clock(self.task, run, STEP_S)
        inputs = torch.tensor(drive[None], dtype=torch.float32)
        with torch.no_grad():
            said = torch.stack([net(inputs)[0] for net in self.networks]).mean(dim=0).numpy().astype(float)
        return self.task.components.grid(read(time_s, self.task.since_start(self.unit * said), run))


@dataclass(frozen=True)
class GRUBaseline:
    """The width is the one that predicts left-out parts best at the tip; one seed gives one result.

    Attributes
    ----------
    seed : of the first weights
    """

    seed: int = 0
    name: str = "GRU"

    def fit(self, task: Task) -> GRU:
        """Learn from the training part."""
        batch = _Batch.of(task)
        folds = batch.folds()
        found: list[tuple[float, int, list[Recurrent]]] = []
        for hidden in HIDDEN:
            fitted = [self._train(batch, hidden, out) for out in folds[:JUDGES]]
            found.append((sum(error for error, _ in fitted), hidden, [net for _, net in fitted]))
        _, hidden, networks = min(found, key=lambda f: f[0])
        networks += [self._train(batch, hidden, out)[1] for out in folds[JUDGES:]]
        return GRU(task, networks, batch.unit, {"hidden": hidden, "networks": len(networks)})

    def _train(self, batch: _Batch, hidden: int, out: NDArray[np.bool_]) -> tuple[float, Recurrent]:
        """Return the squares left of a left-out part (R, K), and the network at the step where they were least."""
        torch.manual_seed(self.seed)
        net = Recurrent(batch.drive.shape[2], hidden, batch.scores.shape[2])
        optimiser = torch.optim.AdamW(net.parameters(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY)
        outside = torch.tensor(out)
        known = batch.part >= 0
        inside = torch.tensor(known & ~out if (known & ~out).any() else known)
        best, kept, since = np.inf, copy.deepcopy(net), 0
        for step in range(STEPS):
            optimiser.zero_grad()
            left = batch.left(net)
            if step % CHECK == 0:
                error = float(left[outside].sum().detach())
                if error < best:
                    best, kept, since = error, copy.deepcopy(net), step
                elif step - since >= PATIENCE:
                    break
            loss = left[inside].sum() / max(int(inside.sum()), 1)
            torch.autograd.backward(loss)
            nn.utils.clip_grad_norm_(net.parameters(), 1.0)
            optimiser.step()
        return best, kept


@dataclass(frozen=True)
class _Batch:
    """All training runs, the shorter ones padded.

    Attributes
    ----------
    drive : shape (B, K, I)
    scores : shape (B, K, R) of size 1, zero where not known
    known : shape (B, K, R)
    part : shape (B, K), -1 where nothing is to be learned
    unit : of the scores [µm]
    relative : whether predictions count from the first sample
    """

    drive: Tensor
    scores: Tensor
    known: Tensor
    part: NDArray[np.intp]
    unit: float
    relative: bool

    @classmethod
    def of(cls, task: Task) -> _Batch:
        runs = training_runs(task, STEP_S)
        longest = max(len(run.time_s) for run in runs)
        drive = np.zeros((len(runs), longest, runs[0].drive.shape[1]))
        scores = np.full((len(runs), longest, task.components.count), np.nan)
        part = np.full((len(runs), longest), -1)
        for i, run in enumerate(runs):
            drive[i, : len(run.time_s)] = run.drive
            scores[i, : len(run.time_s)] = run.scores
            part[i, : len(run.time_s)] = run.part
        known = np.isfinite(scores)
        part[~known.any(axis=2)] = -1
        unit = float(np.sqrt(np.mean(scores[known] ** 2))) if known.any() else 1.0
        unit = unit or 1.0
        goal = torch.tensor(np.where(known, scores, 0.0) / unit, dtype=torch.float32)
        inputs = torch.tensor(drive, dtype=torch.float32)
        return cls(inputs, goal, torch.tensor(known), part, unit, not task.intercept)

    def folds(self) -> list[NDArray[np.bool_]]:
        """Return what is left out in turn; where there is but one part, everything, which then trains as well."""
        known = np.unique(self.part[self.part >= 0])
        groups = [known[k::FOLDS] for k in range(min(FOLDS, len(known)))]
        return [np.isin(self.part, group) for group in groups]

    def left(self, net: Recurrent) -> Tensor:
        """Return the squares left (B, K), over all scores."""
        said = net(self.drive)
        if self.relative:
            said = said - said[:, :1]
        square: Tensor = (torch.where(self.known, self.scores - said, 0.0) ** 2).sum(dim=2)
        return square
