"""The kinematic chain: how the bodies' errors move the tool tip.

The universal model of Su, Li and Wang (2001): a tree of bodies given by the lower-body array, a homogeneous
transform from each body to its lower body, and the volumetric error E = T_w P - T_t D, eq. (8). Everything is in
mm and rad, batched over n poses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from model.exceptions import MachineError
from model.machine import Axis, Machine
from model.structure import path_to
from model.terms import DIRECTIONS
from model.transforms import (
    Array,
    apply,
    apply_inverse,
    exact_error,
    rotation_vector,
    skew,
    small_angle_error,
    translation,
    turn,
)
from model.validation import did_you_mean

Form = Literal["exact", "small-angle"]


@dataclass(frozen=True)
class Deviation:
    """Actual minus nominal of the tool, in the workpiece frame.

    Attributes
    ----------
    position_mm : shape (n, 3). With +0.010 in x the tip is 10 µm further in +X than programmed
    orientation_rad : shape (n, 3), rotation vector of R_actual R_nominal^T
    """

    position_mm: Array
    orientation_rad: Array


class Chain:
    """Kinematics of one machine from workpiece to one tool, ideal and with errors.

    Parameters
    ----------
    machine : the description
    tool : name of the tool leaf; needed only where the machine has several

    Raises
    ------
    MachineError
        where the machine has no such tool, or several and none is named.

    Notes
    -----
    Coordinates `q` have shape (n, A), columns in the order of `machine.axis_names` [mm, degree]. Error terms `e`
    have shape (n, K) or (K,), columns in the order of `machine.terms` [mm, rad]. `tool_mm` is the tool tip D in the
    tool frame, shape (3,), by default the machine's.
    """

    def __init__(self, machine: Machine, tool: str | None = None) -> None:
        self.machine = machine
        names = machine.tool_names
        if tool is None and len(names) > 1:
            raise MachineError(f"machine '{machine.name}' has the tools {', '.join(names)}; name one")
        if tool is not None and tool not in names:
            raise MachineError(f"unknown tool '{tool}' of machine '{machine.name}'" + did_you_mean(tool, list(names)))
        self.tool = tool or names[0]
        self._tool = machine.layout.tools[self.tool]
        self._workpiece = machine.layout.workpiece
        work_path = path_to(machine.bodies, self._workpiece)
        tool_path = path_to(machine.bodies, self._tool)
        self._order = sorted({*work_path, *tool_path})  # a body stands behind its lower body
        self.tool_path = tuple(i for i in tool_path if i not in work_path)
        """Bodies that carry the tool and not the workpiece, from the bed outwards."""
        self.work_path = tuple(i for i in work_path if i not in tool_path)
        """Bodies that carry the workpiece and not the tool, from the bed outwards."""
        # A body under both workpiece and tool moves them together, and its errors cancel.
        self._sign = {i: (i in tool_path) - (i in work_path) for i in self._order}
        self._columns = {i: (self._slots(i, "motion"), self._slots(i, "location")) for i in self._order}
        self._axis = {i: machine.axes[b.axis] for i, b in enumerate(machine.bodies) if b.axis is not None}
        self._to_internal = np.array([machine.axes[a].to_internal for a in machine.axis_names])

    def axis_of(self, body: int) -> Axis | None:
        """Return the axis that moves a body, if one does."""
        return self._axis.get(body)

    def location_of(self, body: int, location: Array) -> Array | None:
        """Return a body's six location terms, where it has them, out of all: those of an `ErrorMap`, shape (L,)."""
        slots = self._columns[body][1]
        if slots is None:
            return None
        first = self.machine.location_columns.index(slots.start)
        return location[first : first + len(DIRECTIONS)]

    def tip(self, q: Array, e: Array | None = None, tool_mm: Array | None = None, form: Form = "exact") -> Array:
        """Return the tool tip in the workpiece frame, shape (n, 3); without `e`, the ideal one: P."""
        return self.pose(q, e, tool_mm, form)[0]

    def pose(
        self, q: Array, e: Array | None = None, tool_mm: Array | None = None, form: Form = "exact"
    ) -> tuple[Array, Array]:
        """Return the tool tip (n, 3) and `work_R_tool` (n, 3, 3), both in the workpiece frame."""
        frames = self._bed_T_bodies(q, e, form)
        work, tool = frames[self._workpiece], frames[self._tool]
        tip = apply_inverse(work, apply(tool, self._tip_in_tool(tool_mm)))
        return tip, np.asarray(np.linalg.solve(work[:, :3, :3], tool[:, :3, :3]), dtype=float)

    def deviation(self, q: Array, e: Array, tool_mm: Array | None = None, form: Form = "exact") -> Deviation:
        """Return where the tool is, less where the ideal chain has it.

        In the exact form the position is minus eq. (8) written in the erroneous workpiece frame. The small-angle
        form builds the chain of eq. (3) and keeps the products of its terms.
        """
        tip, turned = self.pose(q, e, tool_mm, form)
        nominal_tip, nominal = self.pose(q, None, tool_mm)
        return Deviation(tip - nominal_tip, rotation_vector(turned @ np.swapaxes(nominal, -1, -2)))

    def seed_error(self, q: Array, e: Array, tool_mm: Array | None = None, form: Form = "small-angle") -> Array:
        """Return E(t) = T_w P - T_t D of eq. (8) and (12), in the bed frame, shape (n, 3) [mm]."""
        frames = self._bed_T_bodies(q, e, form)
        nominal = self.tip(q, None, tool_mm)
        error: Array = apply(frames[self._workpiece], nominal) - apply(frames[self._tool], self._tip_in_tool(tool_mm))
        return error

    def sensitivity(self, q: Array, tool_mm: Array | None = None) -> Array:
        """Return G(q): to first order, deviation = G e.

        A small displacement d and rotation θ of a body's frame moves the tip by d + θ x r, r reaching from the
        frame's origin to the tip; with the opposite sign for a body on the workpiece side.

        Returns
        -------
        array of shape (n, 6, K), rows x, y, z [mm] and the rotation vector [rad]
        """
        frames, work_R_bed, tip = self._ideal(q, tool_mm)
        result = np.zeros((len(q), 6, len(self.machine.terms)))
        for index in self._order:
            motion, location = self._columns[index]
            for slots, frame in ((motion, frames[index]), (location, self._location_frame(index, frames))):
                if slots is None:
                    continue
                turned = self._sign[index] * work_R_bed @ frame[:, :3, :3]
                lever = apply_inverse(frame, tip)
                result[:, :3, slots] = np.concatenate([turned, -turned @ skew(lever)], axis=-1)
                result[:, 3:, slots.start + 3 : slots.stop] = turned
        return result

    def jacobian(self, q: Array, tool_mm: Array | None = None) -> Array:
        """Return how the ideal tool moves with the axes, in the workpiece frame.

        Returns
        -------
        array of shape (n, 6, A), rows x, y, z [mm] and the rotation vector [rad], per mm or degree
        """
        frames, work_R_bed, tip = self._ideal(q, tool_mm)
        result = np.zeros((len(q), 6, len(self.machine.axis_names)))
        for index in self._order:
            axis = self._axis.get(index)
            if axis is None:
                continue
            column = self.machine.axis_names.index(axis.name)
            base = frames[self.machine.bodies[index].lower] @ self._origin(index)
            along = self._sign[index] * (work_R_bed @ base[:, :3, :3]) @ np.asarray(axis.direction)  # (n, 3)
            if axis.rotary:
                lever = (work_R_bed @ (tip - base[:, :3, 3])[..., None])[..., 0]
                result[:, :3, column] = np.cross(along, lever) * axis.to_internal
                result[:, 3:, column] = along * axis.to_internal
            else:
                result[:, :3, column] = along
        return result

    def _ideal(self, q: Array, tool_mm: Array | None) -> tuple[dict[int, Array], Array, Array]:
        """Return the ideal frames, `work_R_bed`, and the tip in the bed frame."""
        frames = self._bed_T_bodies(q, None, "exact")
        work_R_bed = np.swapaxes(frames[self._workpiece][:, :3, :3], -1, -2)
        return frames, work_R_bed, apply(frames[self._tool], self._tip_in_tool(tool_mm))

    def _bed_T_bodies(self, q: Array, e: Array | None, form: Form) -> dict[int, Array]:
        """Return bed_T_body of each body on the way, eq. (7), each of shape (n, 4, 4)."""
        n = len(q)
        internal = q * self._to_internal
        if e is not None:
            e = np.broadcast_to(e, (n, len(self.machine.terms)))
        error = exact_error if form == "exact" else small_angle_error
        frames = {0: np.broadcast_to(np.eye(4), (n, 4, 4))}
        for index in self._order:
            if index == 0:
                continue
            motion, location = self._columns[index]
            parts = [self._origin(index), self._motion(index, internal)]
            if e is not None and location is not None:
                # eq. (6) puts the location error behind the motion; an ISO squareness turns the motion.
                parts.insert(1 if self.machine.composition == "motion-last" else 2, error(e[:, location]))
            if e is not None and motion is not None:
                parts.append(error(e[:, motion]))
            frame = frames[self.machine.bodies[index].lower]
            for part in parts:
                frame = frame @ part
            frames[index] = frame
        return frames

    def _location_frame(self, index: int, frames: dict[int, Array]) -> Array:
        """Return the ideal frame in which the body's location error acts."""
        if index == 0 or self.machine.composition == "seed":
            return frames[index]
        return frames[self.machine.bodies[index].lower] @ self._origin(index)

    def _origin(self, index: int) -> Array:
        axis = self._axis.get(index)
        return np.eye(4) if axis is None else translation(np.asarray(axis.origin_mm))

    def _motion(self, index: int, internal: Array) -> Array:
        axis = self._axis.get(index)
        if axis is None:
            return np.eye(4)
        coordinate = internal[:, self.machine.axis_names.index(axis.name)]
        direction = np.asarray(axis.direction)
        return turn(coordinate, direction) if axis.rotary else translation(coordinate[:, None] * direction)

    def _tip_in_tool(self, tool_mm: Array | None) -> Array:
        return np.asarray(self.machine.tool.offset_mm if tool_mm is None else tool_mm, dtype=float)

    def _slots(self, body: int, kind: str) -> slice | None:
        """Return where the six terms of that kind of a body stand in `e`."""
        columns = [k for k, t in enumerate(self.machine.terms) if t.body == body and t.kind == kind]
        return slice(columns[0], columns[0] + len(DIRECTIONS)) if columns else None
