"""The structure of a machine of any kind: elastic bodies, joints between them, a spindle at one end.

Frames are those of the machine description: at coordinate 0 a body's frame stands at its axis' `origin_mm` in the lower
body's frame, all axes parallel. Points and parts of a body are given in its own frame, carriages and drives of a joint
in the frame of its lower body [mm]. From that and from where the bodies touch follows every error term.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from data_synth.displacement import Displacement, none
from data_synth.elastic import Elastic, Part
from data_synth.fields import Bend, Fields, Relief
from data_synth.guide import PathTerms, split, split_rotary, split_seed
from data_synth.joints import Joint, LinearJoint, Path, rotations
from data_synth.network import Array
from data_synth.screw import Screw
from data_synth.spindle import Spindle
from data_synth.supports import Foot, middle
from model.exceptions import MachineError
from model.machine import Axis, Machine
from model.term_classes import squareness_terms

__all__ = ["Foot", "Part", "Structure"]

STEP_DEGREE = 30.0  # largest step between positions of a rotary axis: twelve show what comes once per turn (chosen)


@dataclass(frozen=True)
class Structure:
    """What a machine is made of.

    Attributes
    ----------
    bodies : parts of "bed" and of each axis' body, the first of each on its anchors; a body left out is rigid
    ground : the point of the bed that counts as not moving; where the bed itself carries the workpiece, its seat
    joints : of each axis
    spindle : in the body that carries the tool
    workpiece : its seat in the body that carries it
    """

    bodies: Mapping[str, Mapping[str, Part]]
    ground: Foot
    joints: Mapping[str, Joint]
    spindle: Spindle
    workpiece: Foot = field(default_factory=lambda: Foot((0.0, 0.0, 0.0)))

    def fields(self, machine: Machine, node: Mapping[str, int], positions: int) -> Fields:
        """Return all error terms, motion terms at that many positions over each axis' range.

        A rotary axis has more where they would lie further than 30° apart.
        """
        bends = self._bends(machine, node)
        causes = {**node, **{bend.name: len(node) + k for k, bend in enumerate(bends)}}
        paths, leaves = self.displaced(machine, causes)
        at = {name: _positions(axis, positions) for name, axis in machine.axes.items()}
        location = {leaf: np.concatenate([d.shift[0], d.turn[0]]) for leaf, d in leaves.items()}
        motion: dict[str, Array] = {}
        for name in machine.axis_names:
            terms = self._split(machine, name, paths[name], at[name], causes)
            motion[name], location[name] = terms.motion, terms.location
        n = len(node)
        return Fields(
            at,
            {name: m[..., :n] for name, m in motion.items()},
            {name: m[..., :n] for name, m in location.items()},
            bends,
            {name: m[..., n:] for name, m in motion.items()},
            {name: m[..., n:] for name, m in location.items()},
        )

    def displaced(self, machine: Machine, causes: Mapping[str, int]) -> tuple[dict[str, Path], dict[str, Displacement]]:
        """Return where each axis' body goes, and how the leaves "T" and "W" stand that have terms of their own.

        A leaf without them is part of what carries it.
        """
        self._check(machine)
        elastic = self._elastic(machine, causes)
        leaves = self._leaves(machine, elastic, causes)
        paths = {}
        for name, joint in self.joints.items():
            axis = machine.axes[name]
            path = joint.path(axis, elastic[_lower(machine, name)], elastic[name], causes)
            fixed = [leaves.pop(name)] if name in leaves else []
            if joint.connection is not None:
                fixed.append(joint.connection.displacement(causes))
            for more in fixed:
                path = _topped(path, axis, more)
            paths[name] = path
        return paths, leaves

    def _split(self, machine: Machine, name: str, path: Path, at: Array, causes: Mapping[str, int]) -> PathTerms:
        axis, connection = machine.axes[name], self.joints[name].connection
        limits = (axis.low, axis.high)

        def turned(position: Array) -> Array:
            return rotations(axis, position)

        if machine.composition == "seed":
            square = squareness_terms(machine)
            rows = frozenset(row for row, letter in enumerate("XYZABC") if f"E{letter}0{name}" in square)
            joined = none(len(causes)) if connection is None else connection.displacement(causes)
            return split_seed(path, limits, at, turned, rows, joined)
        if axis.rotary:
            return split_rotary(path, axis.direction, limits, at, turned)
        return split(path, axis.direction, limits, at)

    def _elastic(self, machine: Machine, causes: Mapping[str, int]) -> dict[str, Elastic]:
        anchors: dict[str, tuple[Foot, ...]] = {"bed": (self.ground,)}
        for name, joint in self.joints.items():
            anchors[name] = joint.anchors(machine.axes[name])
        return {name: Elastic(name, self.bodies.get(name, {}), feet, causes) for name, feet in anchors.items()}

    def _bends(self, machine: Machine, node: Mapping[str, int]) -> tuple[Bend, ...]:
        elastic = self._elastic(machine, node)
        reliefs = []
        for name, joint in self.joints.items():
            if isinstance(joint, LinearJoint):
                holder = elastic[_lower(machine, name)]
                for drive in joint.drives:
                    if isinstance(drive, Screw) and drive.stretch_K:
                        reliefs.append(_relief(drive, joint, holder, node))
        return (*reliefs, self.spindle.speed_shift)

    def _leaves(
        self, machine: Machine, elastic: Mapping[str, Elastic], causes: Mapping[str, int]
    ) -> dict[str, Displacement]:
        """Return tool's and workpiece's displacement relative to what carries them, by whose terms they are."""
        layout = machine.layout
        found: dict[str, Displacement] = {}
        for index, leaf in ((next(iter(layout.tools.values())), "T"), (layout.workpiece, "W")):
            body = machine.bodies[index]
            name = _key(machine, index)
            if leaf == "T":
                moved = self.spindle.nose(elastic[name], machine.tool.direction, causes)
            else:
                seat = self.workpiece
                moved = elastic[name].displacement(seat.at_mm, seat.on).carried(np.negative(seat.at_mm))
            owner = leaf if body.suffix == leaf else name
            if owner == "bed":
                if np.abs(moved.shift).max() > 1e-12 or np.abs(moved.turn).max() > 1e-15:
                    raise MachineError(
                        f"machine '{machine.name}' must have the ground of its structure where the bed carries "
                        f"{'the tool' if leaf == 'T' else 'the workpiece'}, or error terms there: the bed has none"
                    )
                continue
            found[owner] = found[owner] + moved if owner in found else moved
        return found

    def _check(self, machine: Machine) -> None:
        if set(self.joints) != set(machine.axes):
            raise MachineError(
                f"the structure of machine '{machine.name}' must have one joint for each of its axes "
                f"{', '.join(machine.axis_names)}, got {', '.join(self.joints)}"
            )
        unknown = set(self.bodies) - {"bed", *machine.axes}
        if unknown or len(machine.layout.tools) != 1:
            what = f"got body '{min(unknown)}'" if unknown else f"got tools {', '.join(machine.layout.tools)}"
            raise MachineError(f"the structure of machine '{machine.name}' must be bed, axes and one tool, {what}")
        for name, joint in self.joints.items():
            axis = machine.axes[name]
            if isinstance(joint, LinearJoint) is axis.rotary:
                raise MachineError(f"axis '{name}' must have a {'rotary' if axis.rotary else 'linear'} joint")
            joint.check(axis)


def _lower(machine: Machine, name: str) -> str:
    """Return the key of the body that an axis moves on; what is fixed to a body counts as part of it."""
    index = next(i for i, body in enumerate(machine.bodies) if body.axis == name)
    return _key(machine, machine.bodies[index].lower)


def _key(machine: Machine, index: int) -> str:
    while machine.bodies[index].axis is None and index > 0:
        index = machine.bodies[index].lower
    return machine.bodies[index].axis or "bed"


def _topped(path: Path, axis: Axis, fixed: Displacement) -> Path:
    """Return the path of what is fixed to the body, by its displacement in the body's frame."""

    def topped(position: Array) -> Displacement:
        return path(position) + fixed.seen(rotations(axis, position))

    return topped


def _positions(axis: Axis, least: int) -> Array:
    steps = int(np.ceil((axis.high - axis.low) / STEP_DEGREE - 1e-9)) if axis.rotary else 0
    return np.linspace(axis.low, axis.high, max(least, steps + 1))


def _relief(screw: Screw, joint: LinearJoint, holder: Elastic, node: Mapping[str, int]) -> Relief:
    """Return a screw's relief: it grows between bearings whose distance grows too."""
    k = joint.drives.index(screw)
    carriages = joint.carriages if len(joint.drives) == 1 else joint.carriages[k : k + 1]
    line = middle([carriage.lower() for carriage in carriages])
    if screw.line_mm is not None:
        line = np.array(screw.line_mm, dtype=np.float64)
    ends = np.tile(line, (2, 1))
    ends[:, screw.along] = screw.fixed_mm, screw.far_mm
    moved = holder.displacement(ends, screw.on or carriages[0].on).shift[:, screw.along]
    apart = np.sign(screw.fixed_mm - screw.far_mm) * (moved[0] - moved[1])
    return Relief(screw, screw.growth(node) - apart)
