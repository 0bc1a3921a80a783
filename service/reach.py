"""How far error terms can move a correction, anywhere in the working volume: the measure of the rate limit."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from model.chain import Chain
from model.error_map import ErrorMap
from model.transforms import Array

MOST_KINDS = 64
"""Kinds of machines whose gains are kept: a hall has many machines of few."""
_gains: dict[tuple[str, str], Array] = {}


@dataclass(frozen=True)
class Reach:
    """Largest effect of each error term on each axis' correction, over the working volume and all tools seen.

    To first order the correction is -J^-1 G e, with J the ideal tip's Jacobian and G the sensitivity. For linear
    axes J is constant and G is affine in each coordinate and in the tool's length, so the largest |J^-1 G| stands
    at a corner of the working volume, with the shortest tool or the longest.

    Attributes
    ----------
    gain : shape (A, K), [mm/mm] for linear terms, [mm/rad] for angular ones
    shortest_mm, longest_mm : tool lengths it holds for, besides the machine's own tool; None before the first
    """

    chain: Chain
    gain: Array
    shortest_mm: float | None = None
    longest_mm: float | None = None

    @classmethod
    def of(cls, chain: Chain) -> Reach:
        """Return the reach with the machine's own tool."""
        kind = chain.machine.kind, chain.tool
        gain = _gains.get(kind)
        if gain is None:
            if len(_gains) >= MOST_KINDS:
                _gains.clear()
            gain = _gains[kind] = _gain(chain, None)
        return cls(chain, gain)

    def including(self, tool_length_mm: float | None) -> Reach:
        """Return the reach that holds for a tool of that length, too; None is the machine's own."""
        if tool_length_mm is None:
            return self
        if self.shortest_mm is None or self.longest_mm is None:
            shortest = longest = tool_length_mm
        else:
            shortest = min(self.shortest_mm, tool_length_mm)
            longest = max(self.longest_mm, tool_length_mm)
        if (shortest, longest) == (self.shortest_mm, self.longest_mm):
            return self
        tool_mm = tool_length_mm * np.asarray(self.chain.machine.tool.direction)
        return Reach(self.chain, np.maximum(self.gain, _gain(self.chain, tool_mm)), shortest, longest)

    def correction_mm(self, errors: ErrorMap) -> float:
        """Return a bound of what these error terms can do to any axis' correction, to first order."""
        return float(np.max(self.gain @ largest(errors), initial=0.0))

    def steepness(self, errors: ErrorMap) -> float:
        """Return a bound of how much the correction changes per length that the axes move."""
        return float(np.max(self.gain @ steepest(errors), initial=0.0))


def largest(errors: ErrorMap) -> Array:
    """Return the largest absolute value of each term over its axis, shape (K,) [mm, rad]."""
    machine = errors.machine
    result = np.zeros(len(machine.terms))
    result[machine.location_columns] = np.abs(errors.location)
    for axis in machine.axis_names:
        result[machine.motion_columns[axis]] = np.abs(errors.motion[axis]).max(axis=1)
    return result


def steepest(errors: ErrorMap) -> Array:
    """Return the largest absolute slope of each term over its axis, shape (K,) [mm/mm, rad/mm]."""
    machine = errors.machine
    result = np.zeros(len(machine.terms))
    for axis in machine.axis_names:
        if len(errors.knots[axis]) > 1:
            slopes = np.diff(errors.motion[axis]) / np.diff(errors.knots[axis])
            result[machine.motion_columns[axis]] = np.abs(slopes).max(axis=1)
    return result


def turn_rad(errors: ErrorMap) -> float:
    """Return a bound of the angle by which these error terms can turn any body against the ideal one."""
    angular = np.array([term.angular for term in errors.machine.terms])
    return float(largest(errors)[angular].sum())


def _gain(chain: Chain, tool_mm: Array | None) -> Array:
    machine = chain.machine
    ends = [(machine.axes[a].low, machine.axes[a].high) for a in machine.axis_names]
    corners = np.array(list(itertools.product(*ends)))
    sensitivity = chain.sensitivity(corners, tool_mm)[:, :3, :]
    gain = np.linalg.solve(chain.jacobian(corners, tool_mm)[:, :3], sensitivity)
    return np.asarray(np.abs(gain).max(axis=0), dtype=float)
