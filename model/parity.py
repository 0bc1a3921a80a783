"""Parity: a few steps of a network, computed by torch when it was exported, are computed again where it runs.

So a damaged file, a different runtime or a processor that computes something else is found before the network is
used. Inputs and coefficients are stored by name, so that exchanged names are found as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from model.exceptions import BundleError
from model.fields import Fields
from model.manifest import NetworkRecord, ParityRecord
from model.transforms import Array

PARITY_UM = 1e-3
"""How far the exported network may be from torch, in µm or µrad."""
STORED_UM = 1e-6
"""How far the stored sample may be from what this computer returns, in µm or µrad. Both compute in double precision,
so rounding stays far below; the closer it is, the smaller the damage that it finds."""
STEPS = 8
AT_REST = 2
"""A step with all channels at zero, which networks treat in a way of its own."""
SHORTEST_S, LONGEST_S = 1.0, 7200.0
"""Between two steps [s]. Over far shorter times the exported file rounds differently from torch, by 1e-6 µm."""


class Session(Protocol):
    """What of `onnxruntime.InferenceSession` is used here."""

    def run(self, names: Sequence[str] | None, fed: Mapping[str, Array], /) -> Sequence[Array]:
        """Return the outputs for inputs by name."""


def sample_inputs(
    ranges: Sequence[tuple[float, float]], channels: Sequence[tuple[float, float]], seed: int = 0
) -> tuple[Array, Array]:
    """Return a sequence that every input takes part in: time steps (T,) [s] and inputs (T, S + C).

    Parameters
    ----------
    ranges, channels : valid ranges of the S sensors [°C] and the C channels
    """
    rng = np.random.default_rng(seed)
    # Inputs that never moved in training are moved here: their weights count, too.
    lows = np.array([low for low, _ in (*ranges, *channels)])
    least = np.array([1.0] * len(ranges) + [max(1.0, abs(high)) for _, high in channels])
    spans = np.maximum([high - low for low, high in (*ranges, *channels)], least)
    inputs = lows + spans * rng.uniform(0.0, 1.0, (STEPS, len(lows)))
    dt_s = np.exp(rng.uniform(np.log(SHORTEST_S), np.log(LONGEST_S), STEPS))
    dt_s[0] = 0.0
    inputs[AT_REST, len(ranges) :] = 0.0
    return dt_s, inputs


def parity_record(
    sensors: Sequence[str], channels: Sequence[str], fields: Fields, dt_s: Array, inputs: Array, coefficients: Array
) -> ParityRecord:
    """Return the record of a sequence: inputs of shape (T, S + C) and the coefficients expected, shape (T, P)."""
    return ParityRecord(
        dt_s=dt_s.tolist(),
        inputs={name: inputs[:, i].tolist() for i, name in enumerate((*sensors, *channels))},
        coefficients={term: coefficients[:, where].tolist() for term, where in fields.slices().items()},
    )


def replay(session: Session, modes: int, dt_s: Array, inputs: Array) -> Array:
    """Return the coefficients of a sequence, shape (T, P), one step after another."""
    state, previous, found = np.zeros((1, modes)), inputs[:1], []
    for t in range(len(inputs)):
        fed = {
            "inputs": inputs[t : t + 1],
            "previous": previous,
            "modes": state,
            "dt_s": dt_s[t].reshape(1, 1),
            "fresh": np.full((1, 1), float(t == 0)),
        }
        state, coefficients = session.run(None, fed)
        previous = inputs[t : t + 1]
        found.append(coefficients[0])
    return np.array(found)


def check_parity(session: Session, record: NetworkRecord, fields: Fields, where: str) -> None:
    """Check that the network computes here what it did when it was exported; `where` names the bundle.

    Raises
    ------
    BundleError
        where it does not, or the stored sample is not one of this network.
    """
    sample, names = record.parity, [*record.sensors, *record.channels]
    steps = len(sample.dt_s)
    shapes = {term: (steps, width) for term, width in zip(fields.terms, fields.widths(), strict=True)}
    given = {term: np.shape(_regular(rows)) for term, rows in sample.coefficients.items()}
    if set(sample.inputs) != set(names) or any(len(v) != steps for v in sample.inputs.values()) or given != shapes:
        raise BundleError(f"{where}: the manifest's parity sample is not one of this network; export it again")
    inputs = np.array([sample.inputs[name] for name in names], dtype=float).T
    expected = np.concatenate([np.array(sample.coefficients[term], dtype=float) for term in fields.terms], axis=1)
    try:
        found = replay(session, record.modes, np.array(sample.dt_s, dtype=float), inputs)
    except Exception as problem:
        raise BundleError(f"{where}: network.onnx cannot be run: {one_line(problem)}") from None
    gap = float(np.abs(found - expected).max()) if found.shape == expected.shape else np.inf
    if not gap <= STORED_UM:  # written so that NaN fails
        raise BundleError(
            f"{where}: network.onnx must return what it did when it was exported to {STORED_UM:g} µm, got a difference "
            f"of {gap:.3g}; export it again"
        )


def one_line(problem: Exception) -> str:
    """Return what a runtime says, as the end of a sentence."""
    return " ".join(str(problem).split()).rstrip(".")[:400]


def _regular(rows: list[list[float]]) -> list[list[float]]:
    """Return rows of one length, nothing where they are not."""
    return rows if len({len(row) for row in rows}) == 1 else []
