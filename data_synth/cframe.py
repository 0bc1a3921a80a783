"""A vertical machine with a C frame: table X on saddle Y on the bed, head Z on the column.

Frames as in the machine description, all axes at 0: the bed's origin is where the spindle axis meets the
table's surface; saddle and table have theirs at the same place, the head has its own at the spindle nose. x to
the right, y to the column, z up. The machine is symmetric about the plane x = 0 of the bed.

A moving body is led across its motion by its guides and along it by its screw, at its carriages; from there a
lever reaches its frame's origin. What the carrying part deforms is the upper joint's error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from data_synth.beam import Beam, Vector
from data_synth.displacement import Displacement
from data_synth.fields import Fields, Relief, SpeedShift
from data_synth.guide import split
from data_synth.network import Array
from data_synth.screw import Screw
from model.machine import Machine


@dataclass(frozen=True)
class CFrame:
    """The parts and where they meet [mm].

    Attributes
    ----------
    bed, column : in the bed's frame; saddle : in its own; table : in its own; head : in its own
    bed_anchor : the bed's point that counts as not moving
    column_foot : where the column stands on the bed
    saddle_carriage, head_carriage : at Y = 0 and Z = 0, in the bed's frame
    table_carriage : at X = 0, in the saddle's frame
    saddle_lever, table_lever, head_lever : from carriage to the origin of the body's frame
    screws : of X (held by the saddle), Y (by the bed), Z (by the column)
    flange : where the spindle is bolted to the head, in the head's frame
    spindle : nodes from flange to nose, with lengths
    """

    bed: Beam
    column: Beam
    saddle: Beam
    table: Beam
    head: Beam
    bed_anchor: Vector
    column_foot: Vector
    saddle_carriage: Vector
    table_carriage: Vector
    head_carriage: Vector
    saddle_lever: Vector
    table_lever: Vector
    head_lever: Vector
    screws: tuple[Screw, Screw, Screw]
    flange: Vector
    spindle: Mapping[str, float]
    spindle_expansion_per_K: float
    speed_shift: SpeedShift

    def fields(self, machine: Machine, node: Mapping[str, int], positions: int) -> Fields:
        """Return all error terms, motion terms at that many positions over each axis' range."""
        paths = {"X": self._table(node), "Y": self._saddle(node), "Z": self._head(node)}
        at = {a: np.linspace(machine.axes[a].low, machine.axes[a].high, positions) for a in "XYZ"}
        motion, location = {}, {}
        for name, path in paths.items():
            axis = machine.axes[name]
            terms = split(path, axis.direction, (axis.low, axis.high), at[name])
            motion[name], location[name] = terms.motion, terms.location
        location["T"] = self._tool(node)
        return Fields(at, motion, location, self._reliefs(machine, at, node), self.speed_shift)

    def _saddle(self, node: Mapping[str, int]) -> Callable[[Array], Displacement]:
        screw, move = self.screws[1], np.array([0.0, -1.0, 0.0])

        def path(y: Array) -> Displacement:
            points = np.array(self.saddle_carriage) + y[:, None] * move
            on_guide = self.bed.displacement(points, self.bed_anchor, node)
            bearing = self.bed.displacement(_bearing(screw, points), self.bed_anchor, node)
            return _led(on_guide, bearing, screw, y, node).carried(self.saddle_lever)

        return path

    def _table(self, node: Mapping[str, int]) -> Callable[[Array], Displacement]:
        screw, move = self.screws[0], np.array([-1.0, 0.0, 0.0])
        anchor = np.subtract((0.0, 0.0, 0.0), self.saddle_lever)  # the saddle's carriage, in its own frame
        carriage = -np.array(self.table_lever)
        own = self.table.displacement((0.0, 0.0, 0.0), carriage, node)

        def path(x: Array) -> Displacement:
            points = np.array(self.table_carriage) + x[:, None] * move
            on_guide = self.saddle.displacement(points, anchor, node)
            bearing = self.saddle.displacement(_bearing(screw, points), anchor, node)
            return _led(on_guide, bearing, screw, x, node).carried(self.table_lever) + own

        return path

    def _head(self, node: Mapping[str, int]) -> Callable[[Array], Displacement]:
        screw, move = self.screws[2], np.array([0.0, 0.0, 1.0])

        def on_column(points: Array) -> Displacement:
            foot = self.bed.displacement(self.column_foot, self.bed_anchor, node)
            return self.column.displacement(points, self.column_foot, node) + foot.carried(
                points - np.array(self.column_foot)
            )

        def path(z: Array) -> Displacement:
            points = np.array(self.head_carriage) + z[:, None] * move
            bearing = on_column(_bearing(screw, points))
            return _led(on_column(points), bearing, screw, z, node).carried(self.head_lever)

        return path

    def _tool(self, node: Mapping[str, int]) -> Array:
        """Return the nose's location terms relative to the head's carriages, shape (6, N)."""
        carriage = -np.array(self.head_lever)
        nose = self.head.displacement(self.flange, carriage, node).carried(np.negative(self.flange))
        terms = np.concatenate([nose.shift[0], nose.turn[0]])
        for name, length in self.spindle.items():
            terms[2, node[name]] -= self.spindle_expansion_per_K * length
        return terms

    def _reliefs(self, machine: Machine, at: Mapping[str, Array], node: Mapping[str, int]) -> tuple[Relief, ...]:
        reliefs = []
        holders = (
            (self.saddle, self.table_carriage),
            (self.bed, self.saddle_carriage),
            (self.column, self.head_carriage),
        )
        for screw, (part, carriage) in zip(self.screws, holders, strict=True):
            name = "XYZ"[screw.axis]
            ends = np.tile(carriage, (2, 1))
            ends[:, screw.axis] = screw.fixed_mm, screw.far_mm
            moved = part.displacement(ends, ends[0], node).shift[:, screw.axis]
            apart = np.sign(screw.fixed_mm - screw.far_mm) * (moved[0] - moved[1])
            middle = np.array([(machine.axes[name].low + machine.axes[name].high) / 2])
            mean = float(screw.push(screw.nut_mm(middle))[0])
            rest = screw.push(screw.nut_mm(at[name])) - mean
            reliefs.append(Relief(name, screw, screw.growth(node) - apart, mean, rest))
        return tuple(reliefs)


def _bearing(screw: Screw, carriages_mm: Array) -> Array:
    """Return the point on the guides' line beside the screw's fixed bearing, shape (1, 3)."""
    point = carriages_mm[:1].copy()
    point[0, screw.axis] = screw.fixed_mm
    return point


def _led(
    on_guide: Displacement, bearing: Displacement, screw: Screw, position_mm: Array, node: Mapping[str, int]
) -> Displacement:
    """Return the guides' displacement, along the screw replaced by what the screw does."""
    shift = on_guide.shift.copy()
    shift[:, screw.axis] = bearing.shift[:, screw.axis] + screw.nut_shift(screw.nut_mm(position_mm), node)
    return Displacement(shift, on_guide.turn)
