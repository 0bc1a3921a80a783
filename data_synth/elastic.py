"""A body of the machine: elastic parts that stand rigidly on one another.

The body's frame is rigid and fixed to the body where it is carried: at its carriages or bearings, for the bed at the
ground. The frame's displacement is the joint's error; what the body's own warmth moves relative to its frame is the
error of what it carries.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from data_synth.beam import Beam
from data_synth.displacement import Displacement, none
from data_synth.supports import Foot, middle, rest
from model.exceptions import MachineError
from model.validation import did_you_mean


@dataclass(frozen=True)
class Part:
    """An elastic part, and where it stands on the parts before it: the first part of a body on none."""

    beam: Beam
    feet: tuple[Foot, ...] = ()


class Elastic:
    """A body's own deformation, relative to its frame, which rests on `anchors` [mm, in the body's frame].

    A body without parts is rigid.
    """

    def __init__(
        self, name: str, parts: Mapping[str, Part], anchors: tuple[Foot, ...], node: Mapping[str, int]
    ) -> None:
        self.name, self._parts, self._node = name, parts, node
        for part_name, part in list(parts.items())[1:]:
            if not part.feet:
                raise MachineError(
                    f"part '{part_name}' of body '{name}' must stand on another; only the first part has no feet"
                )
        self._reference = anchors[0].at_mm
        self._middle = middle(anchors)
        self._frame = none(len(node))
        self._frame = rest(anchors, [self.displacement([foot.at_mm], foot.on) for foot in anchors])

    def displacement(self, points_mm: ArrayLike, on: str = "") -> Displacement:
        """Return the displacement of points (n, 3) of the part `on` relative to the body's frame."""
        points = np.atleast_2d(np.asarray(points_mm, dtype=np.float64))
        if not self._parts:
            return none(len(self._node))
        return self._raw(points, self._known(on)) - self._frame.carried(points - self._middle)

    def _raw(self, points: np.ndarray, on: str) -> Displacement:
        """Return the displacement relative to the first part at the reference point."""
        part = self._parts[on]
        if not part.feet:
            return part.beam.displacement(points, self._reference, self._node)
        at = part.feet[0].at_mm
        below = [
            self._raw(np.atleast_2d(np.asarray(foot.at_mm, dtype=np.float64)), self._known(foot.on))
            - part.beam.displacement(foot.at_mm, at, self._node)
            for foot in part.feet
        ]
        stands = rest(part.feet, below)
        return part.beam.displacement(points, at, self._node) + stands.carried(points - middle(part.feet))

    def _known(self, on: str) -> str:
        name = on or next(iter(self._parts))
        if name not in self._parts:
            raise MachineError(f"body '{self.name}' has no part '{name}'" + did_you_mean(name, list(self._parts)))
        return name
