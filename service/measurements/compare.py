"""A probed deviation beside the prediction of its moment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from model.terms import UM
from model.transforms import Array
from model.uncertainty import NORMAL_95
from service.measurements.drift import Compared
from service.measurements.history import Past

if TYPE_CHECKING:
    from service.machine_state import MachineState

USUAL_PROBE_UM = 2.0
"""Uncertainty of a probing that does not tell its own, half of a 95 % interval (chosen: a good touch probe repeats to a
standard deviation of a micrometre)."""


@dataclass(frozen=True)
class Probed:
    """What a probe found.

    Attributes
    ----------
    time_s : when
    position : on the machine's axes [mm], shape (A,)
    deviation_um : in x, y and z; NaN where not measured
    uncertainty_um : half of the probing's own 95 % interval; None where not told
    compensated : whether the correction was active, so that what it left was measured
    tool_length_mm : of the probe; None is the machine's own tool
    """

    time_s: float
    position: tuple[float, ...]
    deviation_um: tuple[float, float, float]
    uncertainty_um: float | None = None
    compensated: bool = False
    tool_length_mm: float | None = None


@dataclass(frozen=True)
class Outcome:
    """What a comparison gives.

    Attributes
    ----------
    predicted_um : what the prediction would have measured there, shape (3,); None where that is not known
    half_width_um : half of the 95 % interval of the difference; None where the bundle does not say
    compared : for the drift monitor; None where it can make nothing of it
    why : the sentence that says why there is none
    """

    predicted_um: tuple[float, float, float] | None
    half_width_um: float | None
    compared: Compared | None
    why: str | None = None


def compare(machine: MachineState, probed: Probed, past: Past) -> Outcome:
    """Compare a probed deviation with a prediction, which must be of a machine with a network.

    Without compensation the measured deviation is that of the machine, so it is compared with the geometric and thermal
    deviation predicted. With it, the thermal part that was not applied is left, and nothing else.
    """
    thermal = machine.thermal
    assert thermal is not None
    q = np.array([probed.position])
    e_thermal = thermal.predictor.fields.evaluate(past.coefficients[None].astype(float), q)
    if past.zero.errors is not None:
        e_thermal = e_thermal - past.zero.errors.evaluate(q)
    e_geometric = machine.bundle.geometry.evaluate(q)
    sd_um = datum_um = None
    spread, at_datum = past.spread, thermal.spread_of(past.zero)
    if machine.interval is not None and spread is not None and at_datum is not None:
        sd_um = _sd_um(machine, q, probed.tool_length_mm, spread)
        datum_um = _sd_um(machine, q, probed.tool_length_mm, at_datum) if past.zero.kind != "absolute" else 0.0
    applied = np.zeros_like(e_geometric)
    if probed.compensated:
        if past.weight is None:
            why = "the correction had not arrived at the prediction then, so what it left cannot be compared"
            return Outcome(None, None, None, why)
        applied = e_geometric + past.weight * e_thermal
    predicted = _tip_um(machine, q, e_geometric + e_thermal, probed.tool_length_mm)
    predicted = predicted - _tip_um(machine, q, applied, probed.tool_length_mm)
    x, y, z = predicted.tolist()
    if sd_um is None or datum_um is None:
        why = "the bundle does not say how far predictions may be off, so whether the machine drifts cannot be told"
        return Outcome((x, y, z), None, None, why)
    own = (USUAL_PROBE_UM if probed.uncertainty_um is None else probed.uncertainty_um) / NORMAL_95
    residual = _difference(probed.deviation_um, (x, y, z))
    both = math.hypot(sd_um, own)
    since_s = None if past.zero.kind == "absolute" else past.zero.time_s
    compared = Compared(probed.time_s, probed.position, residual, both, datum_um, since_s)
    return Outcome((x, y, z), NORMAL_95 * math.hypot(both, datum_um), compared)


def _sd_um(machine: MachineState, q: Array, tool_length_mm: float | None, spread: float) -> float:
    assert machine.interval is not None
    return float(machine.interval.half_width_um(q, tool_length_mm, spread)[0]) / NORMAL_95


def _tip_um(machine: MachineState, q: Array, e: Array, tool_length_mm: float | None) -> Array:
    tool_mm = None if tool_length_mm is None else tool_length_mm * np.asarray(machine.machine.tool.direction)
    moved: Array = (machine.chain.tip(q, e, tool_mm) - machine.chain.tip(q, None, tool_mm))[0] / UM
    return moved


def _difference(measured: Sequence[float], predicted: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = (m - p for m, p in zip(measured, predicted, strict=True))
    return x, y, z
