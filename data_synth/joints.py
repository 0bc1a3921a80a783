"""How one body of the machine moves on another, and where that leaves its frame when both are warm.

To first order: what two bodies do is added, and how a part deforms does not depend on where the other axes stand, but
for the joint's own, whose carriages touch it at other places.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from data_synth.angle import Angle
from data_synth.beam import Beam, Vector
from data_synth.displacement import Displacement
from data_synth.drive import Drive
from data_synth.elastic import Elastic
from data_synth.materials import STEEL
from data_synth.network import Array
from data_synth.race import Race
from data_synth.supports import Foot, middle, rest
from model.exceptions import MachineError
from model.machine import Axis
from model.transforms import turn

OFF_LINE_MM = 5.0  # bearings further than this from the axis' line are a mistake; measures vary by a per cent (chosen)

Path = Callable[[Array], Displacement]
"""From axis positions (n,) to the displacement of the body's frame, in the lower body's axes."""


@dataclass(frozen=True)
class Carriage:
    """Where the bodies of a joint touch at coordinate 0, in the lower body's frame [mm].

    Attributes
    ----------
    on, of : part of the lower body, and of the body itself; "" is the first
    hold : see `Foot`
    """

    at_mm: Vector
    on: str = ""
    of: str = ""
    hold: float = 1.0

    def lower(self) -> Foot:
        """Return the lower body's point."""
        return Foot(self.at_mm, self.on, self.hold)

    def own(self, axis: Axis) -> Foot:
        """Return the body's own point, in its own frame."""
        x, y, z = (a - o for a, o in zip(self.at_mm, axis.origin_mm, strict=True))
        return Foot((x, y, z), self.of, self.hold)


@dataclass(frozen=True)
class Connection:
    """What fixes a body's frame to its carriages: a short piece from its foot to its top, in the body's frame [mm].

    In the composition "seed" its deformation is the location error.
    """

    beam: Beam
    foot_mm: Vector
    top_mm: Vector

    def displacement(self, node: Mapping[str, int]) -> Displacement:
        """Return the displacement of the frame's origin relative to the carriages."""
        return self.beam.displacement(self.top_mm, self.foot_mm, node).carried(np.negative(self.top_mm))


@dataclass(frozen=True)
class LinearJoint:
    """A body led across its motion by guides, at its carriages, and along it by a screw or a scale.

    Attributes
    ----------
    carriages : one, or two
    drives : one, at the middle of the carriages, or one for each carriage
    rail : "lower" where the carriages run along the lower body, "body" where they stand still on it and the moving
        body's own guide runs through them (a ram)
    """

    carriages: tuple[Carriage, ...]
    drives: tuple[Drive, ...]
    rail: Literal["lower", "body"] = "lower"
    connection: Connection | None = None

    def anchors(self, axis: Axis) -> tuple[Foot, ...]:
        """Return the points that the body's frame is fixed to, in its own frame."""
        return tuple(carriage.own(axis) for carriage in self.carriages)

    def check(self, axis: Axis) -> None:
        """Refuse what does not fit the axis."""
        if len(self.drives) not in (1, len(self.carriages)):
            raise MachineError(
                f"axis '{axis.name}' must have one drive, or one for each of its {len(self.carriages)} carriages, "
                f"got {len(self.drives)}"
            )
        for drive in self.drives:
            sign = np.sign(drive.rider_mm(np.ones(1)) - drive.rider_mm(np.zeros(1)))[0]
            if drive.axis != axis.name or abs(sign - axis.direction[drive.along]) > 1e-9:
                raise MachineError(
                    f"a drive of axis '{axis.name}' must be for it and run along {axis.direction}, got one for "
                    f"'{drive.axis}' along coordinate {drive.along} with sign {sign:+g}"
                )

    def path(self, axis: Axis, lower: Elastic, own: Elastic, node: Mapping[str, int]) -> Path:
        """Return where the body's frame goes."""
        feet = [carriage.lower() for carriage in self.carriages]
        at, direction = middle(feet), np.array(axis.direction)
        lever = np.array(axis.origin_mm) - at
        together = len(self.drives) == 1

        def path(position: Array) -> Displacement:
            led = [self._guided(carriage, position, axis, lower, own) for carriage in self.carriages]
            if not together:
                led = [
                    self._pulled(one, drive, carriage, np.array(carriage.at_mm), position, axis, lower, own, node)
                    for one, drive, carriage in zip(led, self.drives, self.carriages, strict=True)
                ]
            rests = rest(feet, led, free=direction if together else None)
            if together:
                rests = self._pulled(rests, self.drives[0], self.carriages[0], at, position, axis, lower, own, node)
            return rests.carried(lever)

        return path

    def _guided(self, carriage: Carriage, position: Array, axis: Axis, lower: Elastic, own: Elastic) -> Displacement:
        """Return what the guide at one carriage does to the body's frame."""
        steps = np.outer(position, axis.direction)
        on_lower, on_own = np.array([carriage.at_mm]), np.array([carriage.own(axis).at_mm])
        if self.rail == "lower":
            on_lower = on_lower + steps
        else:
            on_own = on_own - steps
        return lower.displacement(on_lower, carriage.on) - own.displacement(on_own, carriage.of)

    @staticmethod
    def _pulled(
        led: Displacement,
        drive: Drive,
        carriage: Carriage,
        at: Array,
        position: Array,
        axis: Axis,
        lower: Elastic,
        own: Elastic,
        node: Mapping[str, int],
    ) -> Displacement:
        """Return what the guides do, along the drive replaced by what that does.

        The body's point on the drive's line goes with the nut or the reading head; `at` is where `led` holds.
        """
        k = drive.along
        line = at if drive.line_mm is None else np.array(drive.line_mm, dtype=np.float64)
        bearing, rider = line.copy(), line.copy()
        bearing[k], rider[k] = drive.fixed_mm, drive.rider_mm(np.zeros(1))[0]
        wanted = lower.displacement(bearing, drive.on or carriage.on).shift[:, k] + drive.rider_shift(position, node)
        wanted = wanted - own.displacement(rider - np.array(axis.origin_mm), carriage.of).shift[:, k]
        offset = line - at
        offset[k] = 0.0
        there = led.carried(offset).shift[:, k]
        shift = np.broadcast_to(led.shift, (len(position), *led.shift.shape[1:])).copy()
        shift[:, k] += wanted - there
        return Displacement(shift, led.turn)


@dataclass(frozen=True)
class RotaryJoint:
    """A body that turns in one bearing, or in two on its line.

    Where the bearings stand and how they tilt with the lower body does not turn with the table; the table's own warmth
    does, and shows once per turn. So does run-out of the bearings' rings, and twice.

    Attributes
    ----------
    growth : lengths [mm] of steel that grow with a node and push the body, in the lower body's frame
    angle : what sets the angle; None for one that nothing disturbs
    races : the rings of each bearing; none where they stay round
    """

    bearings: tuple[Carriage, ...]
    growth: Mapping[str, Vector] = field(default_factory=dict)
    angle: Angle | None = None
    races: tuple[Race, ...] = ()
    connection: Connection | None = None

    def anchors(self, axis: Axis) -> tuple[Foot, ...]:
        """Return the points that the body's frame is fixed to, in its own frame."""
        return tuple(bearing.own(axis) for bearing in self.bearings)

    def check(self, axis: Axis) -> None:
        """Refuse what does not fit the axis."""
        off = np.cross(axis.direction, middle([b.lower() for b in self.bearings]) - np.array(axis.origin_mm))
        if np.linalg.norm(off) > OFF_LINE_MM:
            raise MachineError(
                f"the bearings of axis '{axis.name}' must have their middle on its line through {axis.origin_mm}, "
                f"got {np.linalg.norm(off):g} mm off"
            )
        if len(self.races) not in (0, len(self.bearings)):
            raise MachineError(
                f"axis '{axis.name}' must have one race for each of its {len(self.bearings)} bearings, or none, "
                f"got {len(self.races)}"
            )

    def path(self, axis: Axis, lower: Elastic, own: Elastic, node: Mapping[str, int]) -> Path:
        """Return where the body's frame goes."""
        feet = [bearing.lower() for bearing in self.bearings]
        direction = np.array(axis.direction)
        stands = rest(feet, [lower.displacement(foot.at_mm, foot.on) for foot in feet])
        pushed = stands.shift.copy()
        for name, length_mm in self.growth.items():
            pushed[0, :, node[name]] += STEEL.expansion_per_K * np.array(length_mm)
        to_frame = np.array(axis.origin_mm) - middle(feet)
        stands = Displacement(pushed, stands.turn).carried(to_frame)

        def path(position: Array) -> Displacement:
            rotation = rotations(axis, position)
            shape = (len(position), *stands.shift.shape[1:])
            runs = Displacement(np.zeros(shape), np.zeros(shape))
            if self.races:
                angle = position * axis.to_internal
                rings = [race.displacement(direction, angle, rotation, node, shape[-1]) for race in self.races]
                runs = rest(feet, rings).carried(to_frame)
            moved = stands + runs
            if self.angle is None:
                return moved
            wrong = self.angle.turn(own, rotation, node, runs)
            return Displacement(moved.shift, moved.turn + direction[:, None] * wrong[:, None, :])

        return path


Joint = LinearJoint | RotaryJoint


def rotations(axis: Axis, position: Array) -> Array:
    """Return lower_R_body at these axis positions, shape (n, 3, 3): the unit matrix for a linear axis."""
    if not axis.rotary:
        return np.broadcast_to(np.eye(3), (len(position), 3, 3))
    return turn(position * axis.to_internal, np.array(axis.direction))[:, :3, :3]
