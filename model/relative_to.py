"""Convert error tables between the two things that an error can be measured against.

Inside, a term is the error of a body against its lower body ("body"). Instruments show the motion of the tool against
the workpiece ("tool"). The two differ in three ways:

- What moves the workpiece moves the tool the other way: a table that is 10 µm too far in +X leaves the tool 10 µm
  behind. So every motion term of an axis on the workpiece side changes its sign, angles too.
- A location term that displaces or turns an axis' line says where the line lies, which is the same whichever body runs
  along it. Squareness, and the place and tilt of a rotary axis, keep their sign on both sides.
- An instrument sees displacements at its functional point, a body has them at its frame's origin. Between the two the
  angles have a lever, and on the workpiece side it grows with the axis' own position, because the tool travels over
  the body.

Components are along the axes of the body's own frame in both forms; a rotary body's frame turns with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from model.chain import Chain
from model.error_map import ErrorMap, Row
from model.exceptions import DataError
from model.machine import UNIT_VECTORS, Machine, Triple
from model.terms import DIRECTIONS, Term
from model.transforms import Array
from model.validation import did_you_mean

PARALLEL = 1e-9
"""Two unit vectors are parallel or perpendicular when their scalar product is this close to 1 or 0."""


@dataclass(frozen=True)
class FunctionalPoint:
    """Where the tool tip stood, or the instrument's equivalent of it, while one axis was measured.

    Attributes
    ----------
    position : coordinates of the other axes [mm, degree]; those not named stood at 0
    tool_mm : the point in the tool frame; None is the machine's tool tip
    tool : name of the tool leaf, where the machine has several
    """

    position: Mapping[str, float] = field(default_factory=dict)
    tool_mm: Triple | None = None
    tool: str | None = None


def to_body(
    machine: Machine, rows: Iterable[Row], measured_at: Mapping[str, FunctionalPoint] | None = None
) -> list[Row]:
    """Return an error table measured as motion of the tool against the workpiece in the form the chain takes.

    Parameters
    ----------
    rows : term, position [mm, degree], value [µm, µrad]
    measured_at : by axis, where its table was measured. Its rows come back as all six terms at all its positions, and
        are exact there; between them a lever that grows makes a product that is only nearly linear. An axis without
        one is taken as measured at its body's origin: only signs change, row by row.

    Raises
    ------
    DataError
        for a row that no error table may have, an axis that moves tool and workpiece together, or a location term
        oblique to its axis.
    """
    return _convert(machine, rows, measured_at or {}, _body_from_tool)


def to_tool(
    machine: Machine, rows: Iterable[Row], measured_at: Mapping[str, FunctionalPoint] | None = None
) -> list[Row]:
    """Return what an instrument would show of an error table; the inverse of `to_body`, with the same arguments."""
    return _convert(machine, rows, measured_at or {}, _tool_from_body)


def turns_sign(machine: Machine, term: Term) -> bool:
    """Return whether the term has opposite signs in the two forms.

    Raises
    ------
    DataError
        where the term is no motion of the tool against the workpiece, or partly turns its sign and partly not.
    """
    body = machine.bodies[term.body]
    if body.side == 0:
        raise DataError(
            f"{term.name} must be of what moves the tool against the workpiece, but body '{body.name}' carries both; "
            "leave it out"
        )
    if body.side > 0:
        return False
    if term.kind == "motion" or body.axis is None or machine.composition == "seed":
        return True  # the seed's location terms do not reach the line along which their own body moves
    axis = machine.axes[body.axis]
    if not axis.rotary and not term.angular:
        return True  # a linear axis' line is a direction; displaced, it is the same
    along = abs(float(np.dot(UNIT_VECTORS[term.direction], axis.direction)))
    if PARALLEL < along < 1.0 - PARALLEL:
        raise DataError(
            f"{term.name} is oblique to axis {axis.name}, so only a part of it changes sign; convert it by hand"
        )
    return along > 0.5  # along the line it is a zero offset or a roll of the body; across, it moves the line


def _body_from_tool(table: Array, sign: float, arm: Array) -> Array:
    angles = sign * table[3:]
    return np.concatenate([sign * table[:3] - _displacement(arm, angles), angles])


def _tool_from_body(table: Array, sign: float, arm: Array) -> Array:
    return sign * np.concatenate([table[:3] + _displacement(arm, table[3:]), table[3:]])


def _displacement(arm: Array, angles: Array) -> Array:
    """Return what small turns (3, m) [rad] do at the end of the levers `arm` (m, 3, 3), shape (3, m) [mm]."""
    return np.asarray(np.einsum("mij,jm->im", arm, angles), dtype=float)


def _convert(
    machine: Machine,
    rows: Iterable[Row],
    measured_at: Mapping[str, FunctionalPoint],
    form: Callable[[Array, float, Array], Array],
) -> list[Row]:
    rows = list(rows)
    errors = ErrorMap.from_rows(machine, rows)  # refuses what no error table may have
    _check_axes(machine, measured_at)
    converted: list[Row] = []
    measured: set[str] = set()
    for name, position, value in rows:
        term = machine.term(name)
        sign = -1.0 if turns_sign(machine, term) else 1.0
        if term.kind == "motion" and term.axis in measured_at:
            measured.add(term.axis)
        else:
            converted.append((term.name, position, sign * value))
    for axis in (a for a in machine.axis_names if a in measured):
        sign, arm = _levers(machine, axis, errors.knots[axis], measured_at[axis])
        for direction, values in zip(DIRECTIONS, form(errors.motion[axis], sign, arm), strict=True):
            term = machine.term(f"E{direction}{axis}")
            converted += [
                (term.name, float(p), float(v) / term.to_internal)
                for p, v in zip(errors.knots[axis], values, strict=True)
            ]
    return converted


def _check_axes(machine: Machine, measured_at: Mapping[str, FunctionalPoint]) -> None:
    for axis, point in measured_at.items():
        for name in (axis, *point.position):
            if name not in machine.axes:
                raise DataError(
                    f"functional point of axis '{axis}': machine '{machine.name}' has no axis '{name}'"
                    + did_you_mean(name, list(machine.axis_names))
                )


def _levers(machine: Machine, axis: str, knots: Array, point: FunctionalPoint) -> tuple[float, Array]:
    """Return the axis' sign, and B with θ x r = B θ at each knot, r from the body's origin to the functional point."""
    q = np.zeros((len(knots), len(machine.axis_names)))
    for name, value in point.position.items():
        q[:, machine.axis_names.index(name)] = value
    q[:, machine.axis_names.index(axis)] = knots
    tool_mm = None if point.tool_mm is None else np.asarray(point.tool_mm)
    columns = machine.motion_columns[axis]
    seen = Chain(machine, point.tool).sensitivity(q, tool_mm)[:, :, columns]
    turned = seen[:, 3:, 3:]  # ± work_R_body; above it stands ± work_R_body B
    side = machine.bodies[machine.terms[columns[0]].body].side
    return float(side), np.swapaxes(turned, 1, 2) @ seen[:, :3, 3:]
