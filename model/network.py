"""The thermal network in torch: heat sources, thermal modes, decoder. The only file here that imports torch.

Thermal errors lag temperature: each part of the structure follows its heat source like a first-order lag, so the
deformation is a sum of thermal modes. The network says so by construction. Every input, a temperature or a heat
source, drives one mode per time constant; the decoder is linear in inputs and modes, plus a small nonlinear
residual where that earns its place (`training/residual.py`).
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


@dataclass(frozen=True)
class Prior:
    """How large each effect is expected to be before any data is seen.

    The defaults are for data of few runs; with more, `training/choice.py` chooses (docs/network.md).

    Attributes
    ----------
    time_constants_s : of the modes, log-spaced from two minutes to ten hours
    powers : heat of a channel is (value / largest)^power; friction grows with a power of speed that depends on
        load and lubrication, so each channel gets all of these
    source : size of a source at full load, beside one typical temperature swing
    instant : size of an input's immediate effect, beside a mode's
    tau_exponent : size of a temperature's mode grows as (τ / 1 h)^this
    common : share of the sensors' common rise that is taken out, since the machine as a whole hardly bends with it
    """

    time_constants_s: tuple[float, ...] = (120.0, 480.0, 1800.0, 5400.0, 14400.0, 36000.0)
    powers: tuple[float, ...] = (0.5, 1.0, 1.5, 2.0)
    source: float = 8.0
    instant: float = 0.3
    tau_exponent: float = -0.1
    common: float = 0.9


@dataclass(frozen=True)
class InputScale:
    """Constants that bring the inputs to about one.

    Attributes
    ----------
    centre_degC : subtracted from each sensor, length S
    swing_K : of a typical temperature within a run
    largest : value of each channel at full load, length C
    switched : whether a channel is just on or off, so that its power means nothing, length C
    """

    centre_degC: list[float]
    swing_K: float
    largest: list[float]
    switched: list[bool]


class Residual(nn.Module):
    """The nonlinear part of the decoder: few directions in, few directions out.

    Parameters
    ----------
    down : shape (F, D), directions of the features that it looks at
    up : shape (E, P), directions of the coefficients that it moves
    hidden : width
    """

    down: Tensor
    up: Tensor

    def __init__(self, down: Tensor, up: Tensor, hidden: int) -> None:
        super().__init__()
        self.register_buffer("down", down)
        self.register_buffer("up", up)
        self.enter = nn.Linear(down.shape[1], hidden).to(down.dtype)
        self.leave = nn.Linear(hidden, up.shape[0], bias=False).to(down.dtype)
        nn.init.zeros_(self.leave.weight)

    def forward(self, features: Tensor) -> Tensor:
        """Return what to add to the coefficients (..., P), from features (..., F)."""
        added: Tensor = self.leave(torch.tanh(self.enter(features @ self.down))) @ self.up
        return added


class ThermalNetwork(nn.Module):
    """Thermal modes and decoder of one machine.

    Inputs are raw: S temperatures [°C] and C channels in their own units. Outputs are the P coefficients of the
    fields [µm, µrad]. Scaling happens inside, so that training and serving cannot differ.

    Parameters
    ----------
    scale : of the inputs
    prior : sizes and time constants
    coefficients : P
    """

    centre: Tensor
    mix: Tensor
    largest: Tensor
    channel_of: Tensor
    power: Tensor
    tau_s: Tensor
    warm: Tensor
    size: Tensor

    def __init__(self, scale: InputScale, prior: Prior, coefficients: int) -> None:
        super().__init__()
        sensors, taus = len(scale.centre_degC), len(prior.time_constants_s)
        # One power is enough for a channel that is on or off.
        sources = [
            (c, p)
            for p in prior.powers
            for c, switched in enumerate(scale.switched)
            if not switched or p == prior.powers[0]
        ]
        width = sensors + len(sources)
        double = torch.float64
        common = torch.full((sensors, sensors), 1.0 / max(sensors, 1), dtype=double)
        mix = (torch.eye(sensors, dtype=double) - common * (1.0 - math.sqrt(1.0 - prior.common))) / scale.swing_K
        size = torch.ones(width, taus + 1, dtype=double)
        size[:, 0] = prior.instant
        size[:sensors, 1:] = (torch.tensor(prior.time_constants_s, dtype=double) / 3600.0) ** prior.tau_exponent
        size[sensors:] *= prior.source
        self.register_buffer("centre", torch.tensor(scale.centre_degC, dtype=double))
        self.register_buffer("mix", mix)
        self.register_buffer("largest", torch.tensor(scale.largest, dtype=double))
        self.register_buffer("channel_of", torch.tensor([c for c, _ in sources], dtype=torch.long))
        self.register_buffer("power", torch.tensor([p for _, p in sources], dtype=double))
        self.register_buffer("tau_s", torch.tensor(prior.time_constants_s, dtype=double))
        self.register_buffer("warm", (torch.arange(width) < sensors).to(double))
        self.register_buffer("size", size)
        self.linear = nn.Parameter(torch.zeros(width * (taus + 1), coefficients, dtype=double))
        self.bias = nn.Parameter(torch.zeros(coefficients, dtype=double))
        self.residual: Residual | None = None

    @property
    def inputs(self) -> int:
        """Width of the raw input, S + C."""
        return len(self.centre) + len(self.largest)

    @property
    def modes(self) -> int:
        """Number of thermal modes, the state."""
        return len(self.warm) * len(self.tau_s)

    def drive(self, raw: Tensor) -> Tensor:
        """Return what drives the modes (..., I), temperatures and heat sources, from raw inputs (..., S + C)."""
        sensors = len(self.centre)
        temperatures = (raw[..., :sensors] - self.centre) @ self.mix
        if not len(self.channel_of):
            return temperatures
        load = (raw[..., sensors:].abs() / self.largest)[..., self.channel_of]
        heat = torch.where(load > 0, load.clamp_min(1e-9) ** self.power, torch.zeros_like(load))
        return torch.cat([temperatures, heat], dim=-1)

    def start(self, drive: Tensor) -> Tensor:
        """Return the modes (..., I, K) at a first sample: temperatures in equilibrium, sources not felt yet."""
        return (drive * self.warm).unsqueeze(-1).expand(*drive.shape, len(self.tau_s))

    def transition(self, dt_s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return how modes pass a step dt_s (...): a, and the weights of the drive before and now, each (..., K).

        First-order hold, exact: with dh/dt = (v - h) / τ and v linear in between, h' = a h + (φ - a) v0 +
        (1 - φ) v1, a = exp(-Δt / τ), φ = (1 - a) τ / Δt.
        """
        ratio = dt_s.clamp_min(1e-9).unsqueeze(-1) / self.tau_s
        a = torch.exp(-ratio)
        phi = -torch.expm1(-ratio) / ratio
        return a, phi - a, 1.0 - phi

    def features(self, drive: Tensor, modes: Tensor) -> Tensor:
        """Return the decoder's input (..., F), scaled by the prior, from drive (..., I) and modes (..., I, K)."""
        return (torch.cat([drive.unsqueeze(-1), modes], dim=-1) * self.size).flatten(-2)

    def decode(self, features: Tensor) -> Tensor:
        """Return the coefficients (..., P) [µm, µrad]."""
        coefficients = features @ self.linear + self.bias
        return coefficients if self.residual is None else coefficients + self.residual(features)

    def forward(
        self, inputs: Tensor, previous: Tensor, modes: Tensor, dt_s: Tensor, fresh: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Take one step; this is what is exported.

        Parameters
        ----------
        inputs, previous : shape (B, S + C), this sample and the one before
        modes : shape (B, M), state at the one before
        dt_s : shape (B, 1) [s]
        fresh : shape (B, 1), 1 for a first sample, whose state is `start`

        Returns
        -------
        modes of shape (B, M) and coefficients of shape (B, P)
        """
        now, before = self.drive(inputs), self.drive(previous)
        a, from_before, from_now = self.transition(dt_s)  # (B, 1, K)
        held = modes.reshape(-1, len(self.warm), len(self.tau_s))
        stepped = a * held + from_before * before.unsqueeze(-1) + from_now * now.unsqueeze(-1)
        anew = fresh.unsqueeze(-1)
        state = anew * self.start(now) + (1.0 - anew) * stepped
        return state.flatten(-2), self.decode(self.features(now, state))

    def sequence(self, inputs: Tensor, dt_s: Tensor) -> Tensor:
        """Return the features (R, T, F) of whole runs (R, T, S + C); dt_s is (R, T), ignored at first samples."""
        drive = self.drive(inputs)
        a, from_before, from_now = (w.unsqueeze(2) for w in self.transition(dt_s))  # (R, T, 1, K)
        pushed = from_before[:, 1:] * drive[:, :-1].unsqueeze(-1) + from_now[:, 1:] * drive[:, 1:].unsqueeze(-1)
        first = self.start(drive[:, :1])
        return self.features(drive, linear_recurrence(a, torch.cat([first, pushed], dim=1)))


def linear_recurrence(a: Tensor, b: Tensor) -> Tensor:
    """Return h with h_0 = b_0, h_t = a_t h_(t-1) + b_t along dimension 1, in log2(T) sweeps.

    Two steps (a1, b1), (a2, b2) compose to (a2 a1, a2 b1 + b2); doubling the reach each sweep needs no loop over
    time (Hillis and Steele, Commun. ACM 29 (1986) 1170). Stable, since 0 <= a <= 1.
    """
    reach = 1
    while reach < b.shape[1]:
        later = a[:, reach:]
        b = torch.cat([b[:, :reach], later * b[:, :-reach] + b[:, reach:]], dim=1)
        a = torch.cat([a[:, :reach], later * a[:, :-reach]], dim=1)
        reach *= 2
    return b


INPUT_NAMES = ("inputs", "previous", "modes", "dt_s", "fresh")
OUTPUT_NAMES = ("next_modes", "coefficients")


def export_onnx(net: ThermalNetwork) -> bytes:
    """Return the network's step as an ONNX file in double precision, batch size free.

    Double, since a day of small steps is added up in the modes.
    """
    batch = torch.export.Dim("batch", min=1, max=4096)
    example = tuple(torch.ones(2, n, dtype=torch.float64) for n in (net.inputs, net.inputs, net.modes, 1, 1))
    with warnings.catch_warnings(), _quiet("torch.onnx"):
        # The exporter warns of its own dependencies' future and of every input's sharing one batch size.
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            copy.deepcopy(net).eval(),
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
