"""The thermal network in torch: thermal modes, decoder, fields. The only file here that imports torch.

DESIGN: thermal errors lag temperature, each part of the structure following its heat source like a first-order
lag, so the deformation is a sum of a few thermal modes. The network says so by construction.
"""

from __future__ import annotations

import copy
import logging
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor, nn

OPSET = 18
EXPORTER = "torch.onnx dynamo"
SHORTEST_S, LONGEST_S = 60.0, 43200.0
"""Range of the time constants at the start of training: one minute to half a day [s]."""


@dataclass(frozen=True)
class Shape:
    """Sizes of the network.

    Attributes
    ----------
    sensors, channels : width of its input: temperatures, then other channels
    modes : number of thermal modes
    hidden : width of the nonlinear residual, 0 for none
    coefficients : width of its output
    """

    sensors: int
    channels: int
    modes: int
    hidden: int
    coefficients: int

    @property
    def inputs(self) -> int:
        """Width of the input."""
        return self.sensors + self.channels


@dataclass(frozen=True)
class Scaling:
    """Constants that bring inputs and outputs to about one.

    Attributes
    ----------
    reference_degC : temperature at which the machine has its geometry
    temperature_K : of a typical excursion
    channels : largest value of each channel in training
    coefficients : typical size of each coefficient [µm, µrad]
    """

    reference_degC: float
    temperature_K: float
    channels: list[float]
    coefficients: list[float]


class ThermalNetwork(nn.Module):
    """Thermal modes and decoder.

    Inputs are raw: temperatures [°C] and channels in their own units. Outputs are coefficients of the fields
    [µm, µrad]. Scaling happens inside, so that training and serving cannot differ.
    """

    offset: Tensor
    temperature_scale: Tensor
    channel_scale: Tensor
    output_scale: Tensor

    def __init__(self, shape: Shape, scaling: Scaling) -> None:
        super().__init__()
        self.shape = shape
        width = shape.inputs
        self.register_buffer("offset", torch.tensor([scaling.reference_degC] * shape.sensors))
        self.register_buffer("temperature_scale", torch.tensor(scaling.temperature_K))
        self.register_buffer("channel_scale", torch.tensor(scaling.channels))
        self.register_buffer("output_scale", torch.tensor(scaling.coefficients))
        spread = torch.linspace(math.log(SHORTEST_S), math.log(LONGEST_S), shape.modes)
        self.log_tau = nn.Parameter(spread)
        self.log_power = nn.Parameter(torch.zeros(shape.channels))
        self.excite = nn.Linear(width, shape.modes, bias=False)
        self.linear = nn.Linear(width + shape.modes, shape.coefficients, bias=False)
        self.residual = (
            nn.Sequential(
                nn.Linear(width + shape.modes, shape.hidden),
                nn.Tanh(),
                nn.Linear(shape.hidden, shape.coefficients, bias=False),
            )
            if shape.hidden
            else None
        )

    def sources(self, inputs: Tensor) -> Tensor:
        """Return u, the scaled temperatures and the heat of each channel, from inputs (..., S + C).

        Friction heat grows as a power of speed; the power is learned.
        """
        degC, channels = inputs[..., : self.shape.sensors], inputs[..., self.shape.sensors :]
        excess = (degC - self.offset) / self.temperature_scale
        if not self.shape.channels:
            return excess
        relative = channels.abs() / self.channel_scale
        # The floor keeps the gradient of a power finite at standstill.
        heat = (relative + 1e-4) ** self.log_power.exp() - 1e-4 ** self.log_power.exp()
        return torch.cat([excess, heat], dim=-1)

    def decode(self, sources: Tensor, modes: Tensor) -> Tensor:
        """Return coefficients (..., K) of sources (..., S + C) and modes (..., M)."""
        features = torch.cat([sources, modes], dim=-1)
        scaled: Tensor = self.linear(features)
        if self.residual is not None:
            scaled = scaled + self.residual(features)
        return scaled * self.output_scale

    def transition(self, dt_s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return how modes pass dt_s (..., 1): a, and the weights of the drive before and now, each (..., M).

        First-order hold, exact: with dh/dt = (v - h) / τ and v linear in between, h' = a h + (φ - a) v0 +
        (1 - φ) v1, φ = (1 - a) τ / Δt.
        """
        ratio = dt_s / self.log_tau.exp()
        a = torch.exp(-ratio)
        # (1 - a) / ratio tends to 1 as the step vanishes.
        safe = ratio.clamp(min=1e-4)
        phi = torch.where(ratio > 1e-4, -torch.expm1(-safe) / safe, 1.0 - ratio / 2)
        return a, phi - a, 1.0 - phi

    def forward(
        self, inputs: Tensor, previous: Tensor, modes: Tensor, dt_s: Tensor, fresh: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Take one step; this is what is exported.

        Parameters
        ----------
        inputs, previous : shape (B, S + C), this sample and the one before
        modes : shape (B, M), state at the one before
        dt_s : shape (B, 1) [s]
        fresh : shape (B, 1), 1 for the first sample: the modes are in equilibrium with it

        Returns
        -------
        modes of shape (B, M) and coefficients of shape (B, K)
        """
        now, before = self.sources(inputs), self.sources(previous)
        a, from_before, from_now = self.transition(dt_s)
        drive = self.excite(now)
        stepped = a * modes + from_before * self.excite(before) + from_now * drive
        state = fresh * drive + (1.0 - fresh) * stepped
        return state, self.decode(now, state)

    def sequence(self, inputs: Tensor, dt_s: Tensor) -> Tensor:
        """Return coefficients (R, T, K) of whole runs (R, T, S + C); dt_s is (R, T), 0 at their first sample."""
        sources = self.sources(inputs)
        drive = self.excite(sources)
        a, from_before, from_now = self.transition(dt_s.unsqueeze(-1))
        before = torch.cat([drive[:, :1], drive[:, :-1]], dim=1)
        pushed = from_before * before + from_now * drive
        pushed = torch.cat([drive[:, :1], pushed[:, 1:]], dim=1)
        return self.decode(sources, linear_recurrence(a, pushed))

    def time_constants_s(self) -> list[float]:
        """Return the modes' time constants [s]."""
        return [float(t) for t in self.log_tau.detach().exp()]


def linear_recurrence(a: Tensor, b: Tensor) -> Tensor:
    """Return h with h_0 = b_0, h_t = a_t h_(t-1) + b_t along dimension 1, in log2(T) sweeps.

    Two steps (a1, b1), (a2, b2) compose to (a2 a1, a2 b1 + b2); doubling the reach each sweep needs no loop over
    time (Hillis and Steele, 1986). Stable, since 0 <= a <= 1.
    """
    reach = 1
    while reach < b.shape[1]:
        earlier_a, earlier_b = a[:, :-reach], b[:, :-reach]
        later_a, later_b = a[:, reach:], b[:, reach:]
        b = torch.cat([b[:, :reach], later_a * earlier_b + later_b], dim=1)
        a = torch.cat([a[:, :reach], later_a * earlier_a], dim=1)
        reach *= 2
    return b


INPUT_NAMES = ("inputs", "previous", "modes", "dt_s", "fresh")
OUTPUT_NAMES = ("next_modes", "coefficients")


def export_onnx(net: ThermalNetwork) -> bytes:
    """Return the network's step as an ONNX file in double precision, batch size free.

    Double, since a day of small steps is added up in the modes.
    """
    batch = torch.export.Dim("batch", min=1, max=4096)
    wide, modes = net.shape.inputs, net.shape.modes
    example = tuple(torch.ones(2, n, dtype=torch.float64) for n in (wide, wide, modes, 1, 1))
    with warnings.catch_warnings(), _quiet("torch.onnx"):
        # The exporter warns of its own dependencies' future and of every input's sharing one batch size.
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            copy.deepcopy(net).double().eval(),
            example,
            dynamo=True,
            opset_version=OPSET,
            input_names=list(INPUT_NAMES),
            output_names=list(OUTPUT_NAMES),
            dynamic_shapes=tuple({0: batch} for _ in example),
            verbose=False,
        )
    assert program is not None
    proto: bytes = program.model_proto.SerializeToString()
    return proto


@contextmanager
def _quiet(logger: str) -> Iterator[None]:
    """Let only errors of a logger through."""
    log = logging.getLogger(logger)
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)
