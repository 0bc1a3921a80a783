"""The kinematic chain: how the bodies' errors move the tool tip.

The universal model of Su, Li and Wang (2001): a tree of bodies given by the lower-body array, a homogeneous
transform from each body to its lower body, and the volumetric error E = T_w P - T_t D, eq. (8). Everything is in
mm and rad, batched over n poses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from model.machine import Machine
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
)

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
    """Kinematics of one machine, ideal and with errors.

    Parameters
    ----------
    machine : the description

    Notes
    -----
    Coordinates `q` have shape (n, A), columns in the order of `machine.axis_names` [mm]. Error terms `e` have
    shape (n, K) or (K,), columns in the order of `machine.terms` [mm, rad]. `tool_mm` is the tool tip D in the
    tool frame, shape (3,), by default the machine's.
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self._columns = [
            (self._slots(index, "motion"), self._slots(index, "location")) for index in range(len(machine.bodies))
        ]
        self._workpiece = self._leaf(-1)
        self._tool = self._leaf(+1)

    def tip(self, q: Array, e: Array | None = None, tool_mm: Array | None = None, form: Form = "exact") -> Array:
        """Return the tool tip in the workpiece frame, shape (n, 3); without `e`, the ideal one: P."""
        frames = self._bed_T_bodies(q, e, form)
        return apply_inverse(frames[self._workpiece], apply(frames[self._tool], self._tip_in_tool(tool_mm)))

    def deviation(self, q: Array, e: Array, tool_mm: Array | None = None, form: Form = "exact") -> Deviation:
        """Return where the tip is, less where the ideal chain has it.

        In the exact form this is minus eq. (8) written in the erroneous workpiece frame. The small-angle form
        builds the chain of eq. (3) and keeps the products of its terms.
        """
        position = self.tip(q, e, tool_mm, form) - self.tip(q, None, tool_mm)
        actual = self._work_R_tool(q, e, form)
        nominal = self._work_R_tool(q, None, "exact")
        return Deviation(position, rotation_vector(actual @ np.swapaxes(nominal, -1, -2)))

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
        frames = self._bed_T_bodies(q, None, "exact")
        tip = apply(frames[self._tool], self._tip_in_tool(tool_mm))
        work_R_bed = np.swapaxes(frames[self._workpiece][:, :3, :3], -1, -2)
        result = np.zeros((len(q), 6, len(self.machine.terms)))
        for index, body in enumerate(self.machine.bodies):
            for slots, frame in (
                (self._columns[index][0], frames[index]),
                (self._columns[index][1], self._location_frame(index, frames, q)),
            ):
                if slots is None:
                    continue
                turn = body.side * work_R_bed @ frame[:, :3, :3]
                lever = apply_inverse(frame, tip)
                result[:, :3, slots] = np.concatenate([turn, -turn @ skew(lever)], axis=-1)
                result[:, 3:, slots.start + 3 : slots.stop] = turn
        return result

    def tip_jacobian(self, q: Array) -> Array:
        """Return d(ideal tip)/dq in the workpiece frame, shape (n, 3, A)."""
        frames = self._bed_T_bodies(q, None, "exact")
        work_R_bed = np.swapaxes(frames[self._workpiece][:, :3, :3], -1, -2)
        result = np.zeros((len(q), 3, len(self.machine.axis_names)))
        for body in self.machine.bodies:
            if body.axis is None:
                continue
            moves = frames[body.lower][:, :3, :3] @ np.asarray(self.machine.axes[body.axis].direction)
            column = self.machine.axis_names.index(body.axis)
            result[:, :, column] = body.side * (work_R_bed @ moves[..., None])[..., 0]
        return result

    def _bed_T_bodies(self, q: Array, e: Array | None, form: Form) -> list[Array]:
        """Return bed_T_body of each body, eq. (7), each of shape (n, 4, 4)."""
        n = len(q)
        if e is not None:
            e = np.broadcast_to(e, (n, len(self.machine.terms)))
        error = exact_error if form == "exact" else small_angle_error
        frames = [np.broadcast_to(np.eye(4), (n, 4, 4))]
        for index, body in enumerate(self.machine.bodies[1:], start=1):
            motion, location = self._columns[index]
            parts = [self._origin(index), self._motion(index, q)]
            if e is not None and location is not None:
                # eq. (6) puts the location error behind the motion; an ISO squareness turns the motion.
                parts.insert(1 if self.machine.composition == "motion-last" else 2, error(e[:, location]))
            if e is not None and motion is not None:
                parts.append(error(e[:, motion]))
            frame = frames[body.lower]
            for part in parts:
                frame = frame @ part
            frames.append(frame)
        return frames

    def _location_frame(self, index: int, frames: list[Array], q: Array) -> Array:
        """Return the ideal frame in which the body's location error acts."""
        if self.machine.composition == "seed" or index == 0:
            return frames[index]
        return frames[self.machine.bodies[index].lower] @ np.broadcast_to(self._origin(index), (len(q), 4, 4))

    def _origin(self, index: int) -> Array:
        axis = self.machine.bodies[index].axis
        return np.eye(4) if axis is None else translation(np.asarray(self.machine.axes[axis].origin_mm))

    def _motion(self, index: int, q: Array) -> Array:
        axis = self.machine.bodies[index].axis
        if axis is None:
            return np.eye(4)
        coordinate = q[:, self.machine.axis_names.index(axis)]
        return translation(coordinate[:, None] * np.asarray(self.machine.axes[axis].direction))

    def _work_R_tool(self, q: Array, e: Array | None, form: Form) -> Array:
        frames = self._bed_T_bodies(q, e, form)
        return np.asarray(
            np.linalg.solve(frames[self._workpiece][:, :3, :3], frames[self._tool][:, :3, :3]), dtype=float
        )

    def _tip_in_tool(self, tool_mm: Array | None) -> Array:
        return np.asarray(self.machine.tool.offset_mm if tool_mm is None else tool_mm, dtype=float)

    def _slots(self, body: int, kind: str) -> slice | None:
        """Return where the six terms of that kind of a body stand in `e`."""
        columns = [k for k, t in enumerate(self.machine.terms) if t.body == body and t.kind == kind]
        return slice(columns[0], columns[0] + len(DIRECTIONS)) if columns else None

    def _leaf(self, side: int) -> int:
        """Return the body that carries the workpiece (-1) or the tool (+1); the bed, where no axis does."""
        return max((i for i, b in enumerate(self.machine.bodies) if b.side == side), default=0)
