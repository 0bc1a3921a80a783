"""All baselines, in the order of tables."""

from __future__ import annotations

from training.baselines.arx import ARXBaseline
from training.baselines.gru import GRUBaseline
from training.baselines.protocol import Baseline
from training.baselines.ridge import RIDGE, RIDGE_AVERAGES
from training.baselines.trees import TreesBaseline

BASELINES: tuple[Baseline, ...] = (RIDGE, RIDGE_AVERAGES, ARXBaseline(), TreesBaseline(), GRUBaseline())
