"""The plan of a machine for the compiled path: its chain as a list of operations, its error map as tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from model import kernel
from model.chain import Chain
from model.error_map import ErrorMap
from model.exceptions import DataError
from model.machine import Axis
from model.terms import DIRECTIONS
from model.transforms import Array, exact_error, translation

LARGEST_RAD = 0.1
"""Angular errors up to which the compiled path's sine is exact: some six degrees."""
MOST_CELLS = 4096
"""Cells of an axis' look-up; knots closer than a cell cost a step each."""

Op = tuple[int, int, int, int, Array]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Plan:
    """What `kernel.solve` takes besides positions, in its order.

    Attributes
    ----------
    ideal_ops, real_ops : shape (m, 4): operation, axis, what begins there, which vector of its kind
    ideal_constants, real_constants : shape (m, 12): a rotation by rows and a shift, or a direction and a sign
    cells : index of the segment at the beginning of each cell of the axes' look-ups
    segments : start, six values, six slopes of each segment of the axes' tables
    lookup : per axis, first cell, first row, most knots within a cell, shape (A, 3)
    grid : per axis, where its cells begin, cells per mm or degree, the last cell, shape (A, 3)
    tool : tip and axis in the tool frame, shape (6,)
    linear_axes, rotary_axes : columns of the axes that may move
    moving : whether a rotary axis carries a linear one
    knots : of the error map, per axis
    """

    ideal_ops: Ints
    ideal_constants: Array
    real_ops: Ints
    real_constants: Array
    cells: NDArray[np.int32]
    segments: Array
    lookup: Ints
    grid: Array
    tool: Array
    linear_axes: Ints
    rotary_axes: Ints
    moving: bool
    knots: tuple[Array, ...]

    def solve(self, q: Array, start: int, stop: int, results: Array) -> None:
        """Run `kernel.solve` over q[start:stop]."""
        linear, rotary = len(self.linear_axes), len(self.rotary_axes)
        kernel.solve(q, start, stop, self._arguments, linear, rotary, results)

    @cached_property
    def _arguments(self) -> tuple[int, ...]:
        """Addresses and lengths, in the order of `kernel_source.entry`; the arrays stay as long as this does."""
        f8, i8, at = np.float64, np.int64, kernel.address
        ideal, real = len(self.ideal_ops), len(self.real_ops)
        cells, segments, axes = len(self.cells), len(self.segments), len(self.lookup)
        linear, rotary = len(self.linear_axes), len(self.rotary_axes)
        return (
            at(self.ideal_ops, i8, ideal, 4), at(self.ideal_constants, f8, ideal, 12), ideal,
            at(self.real_ops, i8, real, 4), at(self.real_constants, f8, real, 12), real,
            at(self.cells, np.int32, cells), cells, at(self.segments, f8, segments), segments,
            at(self.lookup, i8, axes, 3), at(self.grid, f8, axes, 3), at(self.tool, f8, 6),
            at(self.linear_axes, i8, linear), linear, at(self.rotary_axes, i8, rotary), rotary, int(self.moving),
        )  # fmt: skip

    def carrying(self, chain: Chain, errors: ErrorMap) -> Plan:
        """Return the plan of the same chain, tool and free axes with other errors; they are checked as by `plan`."""
        _check(errors)
        real_ops, real_constants = _packed(_real(chain, errors))
        knots = tuple(errors.knots[axis] for axis in chain.machine.axis_names)
        if all(a is b for a, b in zip(knots, self.knots, strict=True)):
            segments = np.concatenate([_segments(errors.knots[a], errors.motion[a]) for a in chain.machine.axis_names])
            return replace(self, real_ops=real_ops, real_constants=real_constants, segments=segments)
        cells, segments, lookup, grid = _tables(errors)
        return replace(
            self,
            real_ops=real_ops,
            real_constants=real_constants,
            cells=cells,
            segments=segments,
            lookup=lookup,
            grid=grid,
            knots=knots,
        )


def plan(chain: Chain, errors: ErrorMap, tool_mm: Array | None, keep: Sequence[str] = ()) -> Plan:
    """Return the plan of a chain with these errors and this tool; the axes in `keep` stay as programmed.

    Raises
    ------
    DataError
        where an error term is not finite, or an angular one leaves ±0.1 rad, or the tool is not three finite
        numbers.
    """
    _check(errors)
    names = chain.machine.axis_names
    free = {a: i for i, a in enumerate(names) if a not in keep}
    linear = [a for a in free if not chain.machine.axes[a].rotary]
    rotary = [a for a in free if chain.machine.axes[a].rotary]
    moving = _carried(chain, linear)
    if not _follow(chain, linear, moving=moving):
        rotary = []  # position first: a turn would take the tip along
    tip = np.asarray(chain.machine.tool.offset_mm if tool_mm is None else tool_mm, dtype=float)
    if tip.shape != (3,) or not np.isfinite(tip).all():
        raise DataError(f"the tool tip must be three finite numbers of mm, got {tip}")
    tool = np.concatenate([tip, np.asarray(chain.machine.tool.direction, dtype=float)])
    ideal_ops, ideal_constants = _packed(_ideal(chain, linear, rotary, moving=moving))
    real_ops, real_constants = _packed(_real(chain, errors))
    cells, segments, lookup, grid = _tables(errors)
    return Plan(
        ideal_ops,
        ideal_constants,
        real_ops,
        real_constants,
        cells,
        segments,
        lookup,
        grid,
        tool,
        np.array([free[a] for a in linear], dtype=np.int64),
        np.array([free[a] for a in rotary], dtype=np.int64),
        moving,
        tuple(errors.knots[axis] for axis in names),
    )


def _check(errors: ErrorMap) -> None:
    machine = errors.machine
    for axis in machine.axis_names:
        values = errors.motion[axis]
        if not (np.isfinite(values).all() and np.abs(values[3:]).max() <= LARGEST_RAD):
            raise DataError(
                f"motion terms of axis '{axis}' must be finite, and angles within ±{LARGEST_RAD:g} rad, got "
                f"{np.abs(values[3:]).max():.3g} rad"
            )
    angles = np.abs(errors.location.reshape(-1, len(DIRECTIONS))[:, 3:])
    if not (np.isfinite(errors.location).all() and angles.max(initial=0.0) <= LARGEST_RAD):
        raise DataError(
            f"location terms must be finite, and angles within ±{LARGEST_RAD:g} rad, got "
            f"{angles.max(initial=0.0):.3g} rad"
        )


def _carried(chain: Chain, linear: Sequence[str]) -> bool:
    """Return whether a rotary axis stands between the bed and one of these axes."""
    for path in (chain.tool_path, chain.work_path):
        turned = False
        for body in path:
            axis = chain.axis_of(body)
            if axis is None:
                continue
            if turned and axis.name in linear:
                return True
            turned = turned or axis.rotary
    return False


def _follow(chain: Chain, linear: Sequence[str], *, moving: bool) -> bool:
    """Return whether the linear axes reach every direction, so that they can follow where a turn takes the tip."""
    if moving or len(linear) < 3:
        return len(linear) >= 3
    return bool(np.linalg.svd(_columns_on_bed(chain, linear), compute_uv=False).min() > kernel.SINGULAR)


def _ideal(chain: Chain, linear: Sequence[str], rotary: Sequence[str], *, moving: bool) -> list[Op]:
    """Return the ideal chain from the tool to the bed and up to the workpiece."""
    ops: list[Op] = []
    for body in reversed(chain.tool_path):
        axis = chain.axis_of(body)
        if axis is not None:
            ops += [_motion(chain, axis, 1.0, linear if moving else (), rotary), _shift(np.asarray(axis.origin_mm))]
    if not moving:
        for v, row in enumerate(np.linalg.pinv(_columns_on_bed(chain, linear)) if linear else ()):
            ops.append((kernel.PLACE, 0, kernel.LINEAR, v, _constants(direction=row)))
    for body in chain.work_path:
        axis = chain.axis_of(body)
        if axis is not None:
            ops += [_shift(-np.asarray(axis.origin_mm)), _motion(chain, axis, -1.0, linear if moving else (), rotary)]
    return _merged(ops)


def _columns_on_bed(chain: Chain, linear: Sequence[str]) -> Array:
    """Return how the tool moves against the workpiece with each linear axis, on the bed, shape (3, L)."""
    columns = np.zeros((3, len(linear)))
    for sign, path in ((1.0, chain.tool_path), (-1.0, chain.work_path)):
        for axis in filter(None, map(chain.axis_of, path)):
            if axis.name in linear:
                columns[:, linear.index(axis.name)] = sign * np.asarray(axis.direction)
    return columns


def _motion(chain: Chain, axis: Axis, sign: float, linear: Sequence[str], rotary: Sequence[str]) -> Op:
    column = chain.machine.axis_names.index(axis.name)
    along = np.asarray(axis.direction, dtype=float)
    if axis.rotary:
        begins, vector = (kernel.ROTARY, rotary.index(axis.name)) if axis.name in rotary else (kernel.NOTHING, 0)
        return kernel.TURN, column, begins, vector, _constants(direction=along, sign=sign)
    begins, vector = (kernel.LINEAR, linear.index(axis.name)) if axis.name in linear else (kernel.NOTHING, 0)
    return kernel.SLIDE, column, begins, vector, _constants(direction=sign * along)


def _real(chain: Chain, errors: ErrorMap) -> list[Op]:
    """Return the erroneous chain, eq. (6) and (7), from the tool to the bed and up to the workpiece."""
    ops: list[Op] = []
    for body in reversed(chain.tool_path):
        ops += _joint(chain, errors, body)
    for body in chain.work_path:
        ops += [_inverse(op) for op in reversed(_joint(chain, errors, body))]
    return _merged(ops)


def _joint(chain: Chain, errors: ErrorMap, body: int) -> list[Op]:
    """Return what carries a point from a body's frame into its lower body's, in the order of application."""
    axis = chain.axis_of(body)
    location = chain.location_of(body, errors.location)
    placed = [] if location is None else [_affine(exact_error(location[None])[0])]
    if axis is None:
        return placed
    column = chain.machine.axis_names.index(axis.name)
    ops: list[Op] = []
    if errors.motion[axis.name].any():
        ops.append((kernel.ERROR, column, kernel.NOTHING, 0, _constants()))
    motion = _motion(chain, axis, 1.0, (), ())
    # eq. (6) puts the location error behind the motion; an ISO squareness turns the motion.
    ops += [motion, *placed] if chain.machine.composition == "motion-last" else [*placed, motion]
    return [*ops, _shift(np.asarray(axis.origin_mm))]


def _inverse(op: Op) -> Op:
    kind, axis, begins, vector, k = op
    if kind in {kernel.SHIFT, kernel.AFFINE}:
        return kind, axis, begins, vector, _affine(np.asarray(np.linalg.inv(_matrix(k)), dtype=float))[4]
    if kind == kernel.SLIDE:
        return kind, axis, begins, vector, -k
    if kind == kernel.TURN:
        return kind, axis, begins, vector, _constants(direction=k[:3], sign=-k[3])
    return kernel.ERROR_BACK, axis, begins, vector, k


def _merged(ops: Sequence[Op]) -> list[Op]:
    """Return the operations with constant motions that follow each other made one, and empty ones dropped."""
    merged: list[Op] = []
    for op in ops:
        constant = op[0] in {kernel.SHIFT, kernel.AFFINE}
        if constant and merged and merged[-1][0] in {kernel.SHIFT, kernel.AFFINE}:
            merged[-1] = _affine(_matrix(op[4]) @ _matrix(merged[-1][4]))
        elif not constant or op[4][9:].any() or op[0] == kernel.AFFINE:
            merged.append(op)
    return merged


def _constants(direction: Array | Sequence[float] = (0.0, 0.0, 0.0), sign: float = 1.0) -> Array:
    k = np.zeros(12)
    k[:3], k[3] = direction, sign
    return k


def _shift(offset: Array) -> Op:
    return _affine(translation(offset))


def _affine(matrix: Array) -> Op:
    rotation = matrix[:3, :3]
    kind = kernel.SHIFT if np.array_equal(rotation, np.eye(3)) else kernel.AFFINE
    return kind, 0, kernel.NOTHING, 0, np.concatenate([rotation.ravel(), matrix[:3, 3]])


def _matrix(k: Array) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = k[:9].reshape(3, 3), k[9:]
    return matrix


def _packed(ops: Sequence[Op]) -> tuple[Ints, Array]:
    heads = np.array([op[:4] for op in ops], dtype=np.int64).reshape(-1, 4)
    return heads, np.array([op[4] for op in ops]).reshape(-1, 12)


def _tables(errors: ErrorMap) -> tuple[NDArray[np.int32], Array, Ints, Array]:
    """Return the motion terms of all axes as segments, found through cells of equal width.

    The first segment of an axis reaches from below to its first knot, the last from its last knot on; both are flat.
    """
    cells, segments, lookup, grid = [], [], [], []
    first_cell = first_row = 0
    for axis in errors.machine.axis_names:
        knots = errors.knots[axis]
        rows = _segments(knots, errors.motion[axis])
        width, begins, segment, steps = _cells(knots)
        cells.append(segment)
        segments.append(rows)
        lookup.append((first_cell, first_row, steps))
        grid.append((begins, 1.0 / width, len(segment) - 1.0))
        first_cell += len(segment)
        first_row += len(rows)
    return np.concatenate(cells), np.concatenate(segments), np.array(lookup, dtype=np.int64), np.array(grid)


def _segments(knots: Array, values: Array) -> Array:
    """Return the segments of an axis, one after the other."""
    rows = np.zeros((len(knots) + 2, kernel.ROW))
    rows[0, 0], rows[1:-1, 0], rows[-1, 0] = knots[0], knots, np.inf
    rows[0, 1:7], rows[1:-1, 1:7] = values[:, 0], values.T
    if len(knots) > 1:
        rows[1:-2, 7:13] = ((values[:, 1:] - values[:, :-1]) / (knots[1:] - knots[:-1])).T
    return rows.ravel()


def _cells(knots: Array) -> tuple[float, float, NDArray[np.int32], int]:
    """Return the cells' width, where they begin, the segment at the beginning of each, the most knots within one."""
    span = float(knots[-1] - knots[0])
    if not span > 0.0:
        return 1.0, float(knots[0]), np.zeros(1, dtype=np.int32), 1
    count = int(np.clip(np.ceil(span / np.diff(knots).min()), 1, MOST_CELLS))
    width, begins = span / count, float(knots[0])
    # As the compiled path computes it, so that a knot is counted in the cell in which it is looked for.
    home = np.clip((knots - begins) * (1.0 / width), 0.0, count).astype(np.intp)
    within = np.bincount(home, minlength=count + 1)
    before = np.concatenate([[0], np.cumsum(within)[:-1]])
    return width, begins, before.astype(np.int32), int(within.max())
