"""Geometric (cold) errors: what a machine has from assembly, at its reference temperature.

A motion error is a smooth polynomial of the axis' position; straightness brings its slope as an angle; a
positioning error adds the screw's harmonic once a turn; location errors hold the squareness of assembly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Legendre, Polynomial

from data_synth.network import Array
from model.machine import Machine


@dataclass(frozen=True)
class Workmanship:
    """Typical size of each kind of cold error: a machining centre of normal accuracy.

    Chosen: a third to a half of what acceptance tests of such machines tolerate, some 20 µm in positioning and
    straightness over a metre and 40 µrad in squareness.
    """

    positioning_um: float = 8.0
    straightness_um: float = 3.0
    roll_urad: float = 12.0
    pitch_um: float = 1.5
    pitch_mm: float = 16.0
    location_um: float = 5.0
    squareness_urad: float = 18.0
    points: int = 26


NORMAL = Workmanship()


@dataclass(frozen=True)
class Row:
    """One row of a geometry table; `position` is None for location terms."""

    term: str
    position: float | None
    value: float


def geometry(machine: Machine, rng: np.random.Generator, quality: Workmanship = NORMAL) -> tuple[Row, ...]:
    """Return the cold errors of one machine, in the order of its terms [µm, µrad]."""
    curves = {axis: _axis(axis, machine, rng, quality) for axis in machine.axis_names}
    rows = []
    for term in machine.terms:
        if term.kind == "motion":
            at, values = curves[term.axis]
            rows += [
                Row(term.name, round(float(p), 6), round(float(v), 4))
                for p, v in zip(at, values[term.direction], strict=True)
            ]
        else:
            spread = quality.squareness_urad if term.angular else quality.location_um
            rows.append(Row(term.name, None, round(float(rng.normal(0.0, spread)), 4)))
    return tuple(rows)


def _axis(
    name: str, machine: Machine, rng: np.random.Generator, quality: Workmanship
) -> tuple[Array, dict[str, Array]]:
    axis = machine.axes[name]
    at = np.linspace(axis.low, axis.high, quality.points)
    d = np.array(axis.direction)
    along = int(np.argmax(np.abs(d)))
    shifts = {k: _smooth(axis.low, axis.high, quality.straightness_um, 2, rng) for k in range(3) if k != along}
    slopes = np.zeros((3, len(at)))
    values: dict[str, Array] = {}
    for k, shift in shifts.items():
        values["XYZ"[k]] = shift(at)
        slopes[k] = 1e3 * shift.deriv()(at)  # µm/mm to µrad
    turn = np.cross(d, slopes, axisb=0, axisc=0)  # the body turns as its path does
    turn[along] = _smooth(axis.low, axis.high, quality.roll_urad, 1, rng)(at)
    phase, wave = rng.uniform(0, 2 * np.pi), abs(rng.normal(0.0, quality.pitch_um))
    pitch = wave * np.sin(2 * np.pi * at / quality.pitch_mm + phase)
    values["XYZ"[along]] = _smooth(axis.low, axis.high, quality.positioning_um, 1, rng)(at) + pitch
    return at, {**values, **dict(zip("ABC", turn, strict=True))}


def _smooth(low: float, high: float, size: float, lowest: int, rng: np.random.Generator) -> Polynomial:
    """Return a random polynomial of degree 5 without its terms below `lowest`, each degree half the one before."""
    weights = np.array([0.0 if k < lowest else 0.5 ** (k - lowest) for k in range(6)])
    series = Legendre(size * weights * rng.normal(size=6), domain=[low, high])
    return series.convert(kind=Polynomial)
