"""Geometric (cold) errors: what a machine has from assembly, at its reference temperature.

A linear axis' motion error is a smooth polynomial of its position; straightness brings its slope as an angle; a
positioning error adds the screw's, once a turn and twice, at positions close enough to show it. A rotary axis' are
harmonics of its angle: along its line and about it from once per turn, across it from twice, since once per turn and a
constant are where the line stands and where the body sits on it. Location errors hold the squareness of assembly; in
the composition "seed", where they turn no path, the straightness has the slope too, and the paper's secondary terms are
small.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Legendre, Polynomial

from data_synth.network import Array
from model.machine import Axis, Machine
from model.term_classes import squareness_terms


@dataclass(frozen=True)
class Workmanship:
    """Typical size of each kind of cold error: a machining centre of normal accuracy.

    Chosen: a third to a half of what acceptance tests of such machines tolerate, some 20 µm in positioning and
    straightness over a metre and 40 µrad in squareness. A rotary table's angle within some ±5 arcseconds (25 µrad),
    its run-out some micrometres.

    Attributes
    ----------
    pitch_um, pitch_mm : what comes once a turn of the screws, and their lead
    without_screw : axes that a rack moves and a scale measures
    angle_urad, axial_um, radial_um, tilt_urad : of a rotary axis
    secondary : size of the secondary location terms in the composition "seed", as a share of the others': two to
        three orders of magnitude below the motion terms (su2001.txt, section 3.3)
    points, step_degree : number of positions on a linear axis, largest step on a rotary one
    """

    positioning_um: float = 8.0
    straightness_um: float = 3.0
    roll_urad: float = 12.0
    pitch_um: float = 1.5
    pitch_mm: float = 16.0
    location_um: float = 5.0
    squareness_urad: float = 18.0
    angle_urad: float = 10.0
    axial_um: float = 1.5
    radial_um: float = 1.5
    tilt_urad: float = 5.0
    secondary: float = 0.005
    points: int = 26
    step_degree: float = 15.0
    without_screw: tuple[str, ...] = ()


NORMAL = Workmanship()

PER_TURN = 8  # positions of a positioning error in one turn of the screw: what comes twice is still seen (chosen)
TWICE = 0.3  # what comes twice a turn, as a share of what comes once (chosen)

Curves = dict[str, tuple[Array, Array]]
"""Positions and values, by direction."""


@dataclass(frozen=True)
class Row:
    """One row of a geometry table; `position` is None for location terms."""

    term: str
    position: float | None
    value: float


def geometry(machine: Machine, rng: np.random.Generator, quality: Workmanship = NORMAL) -> tuple[Row, ...]:
    """Return the cold errors of one machine, in the order of its terms [µm, µrad]."""
    seed = machine.composition == "seed"
    square = (
        {name: float(rng.normal(0.0, quality.squareness_urad)) for name in squareness_terms(machine)} if seed else {}
    )
    curves: dict[str, Curves] = {}
    for name in machine.axis_names:
        axis = machine.axes[name]
        if axis.rotary:
            curves[name] = _rotary(axis, rng, quality)
        else:
            curves[name] = _linear(axis, rng, quality, _slope(axis, square))
    rows = []
    for term in machine.terms:
        if term.kind == "motion":
            rows += [
                Row(term.name, round(float(p), 6), round(float(v), 4))
                for p, v in zip(*curves[term.axis][term.direction], strict=True)
            ]
        elif term.name in square:
            rows.append(Row(term.name, None, round(square[term.name], 4)))
        else:
            spread = quality.squareness_urad if term.angular else quality.location_um
            spread *= quality.secondary if seed else 1.0
            rows.append(Row(term.name, None, round(float(rng.normal(0.0, spread)), 4)))
    return tuple(rows)


def _slope(axis: Axis, square: Mapping[str, float]) -> Array:
    """Return the slope of an axis' path by its squareness, shape (3,) [µrad]."""
    turned = np.array([square.get(f"E{letter}0{axis.name}", 0.0) for letter in "ABC"])
    slope: Array = np.cross(turned, axis.direction)
    return slope


def _linear(axis: Axis, rng: np.random.Generator, quality: Workmanship, slope_urad: Array) -> Curves:
    at = np.linspace(axis.low, axis.high, quality.points)
    d = np.array(axis.direction)
    along = int(np.argmax(np.abs(d)))
    shifts = {k: _smooth(axis.low, axis.high, quality.straightness_um, 2, rng) for k in range(3) if k != along}
    slopes = np.zeros((3, len(at)))
    curves: Curves = {}
    for k, shift in shifts.items():
        curves["XYZ"[k]] = at, shift(at) + 1e-3 * slope_urad[k] * at
        slopes[k] = 1e3 * shift.deriv()(at)  # µm/mm to µrad
    turn = np.cross(d, slopes, axisb=0, axisc=0)  # the body turns as its path does
    turn[along] = _smooth(axis.low, axis.high, quality.roll_urad, 1, rng)(at)
    phase, wave = rng.uniform(0, 2 * np.pi), abs(rng.normal(0.0, quality.pitch_um))
    course = _smooth(axis.low, axis.high, quality.positioning_um, 1, rng)
    if axis.name in quality.without_screw:
        curves["XYZ"[along]] = at, course(at)
    else:
        dense = _per_turn(axis, quality)
        angle = 2 * np.pi * dense / quality.pitch_mm + phase
        curves["XYZ"[along]] = dense, course(dense) + wave * (np.sin(angle) + TWICE * np.sin(2.0 * angle + phase))
    return {**curves, **{letter: (at, values) for letter, values in zip("ABC", turn, strict=True)}}


def _per_turn(axis: Axis, quality: Workmanship) -> Array:
    """Return positions that show a turn of the screw: wider apart, its error would be a constant or a beat."""
    steps = int(np.ceil((axis.high - axis.low) / (quality.pitch_mm / PER_TURN)))
    return np.linspace(axis.low, axis.high, max(quality.points, steps + 1))


def _rotary(axis: Axis, rng: np.random.Generator, quality: Workmanship) -> Curves:
    steps = int(np.ceil((axis.high - axis.low) / quality.step_degree))
    at = np.linspace(axis.low, axis.high, max(quality.points, steps + 1))
    along = int(np.argmax(np.abs(axis.direction)))
    curves: Curves = {}
    for letters, across, own in (
        ("XYZ", quality.radial_um, quality.axial_um),
        ("ABC", quality.tilt_urad, quality.angle_urad),
    ):
        for k, letter in enumerate(letters):
            curves[letter] = at, _harmonics(at, own if k == along else across, 1 if k == along else 2, rng)
    return curves


def _harmonics(at_degree: Array, size: float, lowest: int, rng: np.random.Generator) -> Array:
    """Return a random sum of three harmonics of the angle from `lowest` on, each half the one before."""
    total = np.zeros(len(at_degree))
    for k in range(3):
        cosine, sine = size * 0.5**k * rng.normal(size=2)
        angle = np.radians((lowest + k) * at_degree)
        total += cosine * np.cos(angle) + sine * np.sin(angle)
    return total


def _smooth(low: float, high: float, size: float, lowest: int, rng: np.random.Generator) -> Polynomial:
    """Return a random polynomial of degree 5 without its terms below `lowest`, each degree half the one before."""
    weights = np.array([0.0 if k < lowest else 0.5 ** (k - lowest) for k in range(6)])
    series = Legendre(size * weights * rng.normal(size=6), domain=[low, high])
    return series.convert(kind=Polynomial)
