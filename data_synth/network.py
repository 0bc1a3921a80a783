"""The lumped thermal network: nodes that store heat, links that carry it, boundaries that hold a temperature.

    C dT/dt = P - L(o) T + G(o) T_boundary

`o` is an operating point: what changes the links (air stirred by the spindle, coolant, an open door, moving
screws). Between two samples power, boundaries and operating point are held, so a step is a matrix exponential
and exact.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OperatingPoint:
    """What the links depend on.

    Attributes
    ----------
    speed : spindle speed as a share of the highest, rounded to a tabulated level
    coolant, door, moving : coolant flows, door stands open, an axis moves
    """

    speed: float = 0.0
    coolant: bool = False
    door: bool = False
    moving: bool = False


REST = OperatingPoint()


@dataclass(frozen=True)
class Film:
    """How a link's conductance depends on the operating point: a sum of shares of its nominal conductance.

    `spindle` is what full speed adds; it grows as speed^(2/3), forced convection on a rotating cylinder
    (Bossmanns and Tu, Int. J. Mach. Tools Manuf. 39 (1999) 1345: Nu = 0.133 Re^(2/3) Pr^(1/3)).
    """

    still: float = 1.0
    spindle: float = 0.0
    coolant: float = 0.0
    door: float = 0.0
    moving: float = 0.0

    def factor(self, point: OperatingPoint) -> float:
        """Return the share of the nominal conductance at this operating point."""
        return float(
            self.still
            + self.spindle * point.speed ** (2.0 / 3.0)
            + self.coolant * point.coolant
            + self.door * point.door
            + self.moving * point.moving
        )


STEADY = Film()


@dataclass(frozen=True)
class Link:
    """A path of heat between two nodes, or from a node `a` to a boundary `b`."""

    a: str
    b: str
    W_per_K: float
    film: Film = STEADY


@dataclass(frozen=True)
class Step:
    """One exact step: T(t + Δt) = decay T + by_power P + by_boundary T_boundary."""

    decay: Array  # (N, N)
    by_power: Array  # (N, N)
    by_boundary: Array  # (N, M)


@dataclass(frozen=True)
class Network:
    """Nodes with their capacities [J/K], boundaries, links.

    Every link names known nodes, and every node has a path to a boundary.
    """

    capacities: Mapping[str, float]
    boundaries: tuple[str, ...]
    links: tuple[Link, ...]
    _steps: dict[tuple[OperatingPoint, float], Step] = field(default_factory=dict, repr=False, compare=False)

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of the N nodes, in the order of every array of temperatures."""
        return tuple(self.capacities)

    def index(self) -> dict[str, int]:
        """Return the column of each node."""
        return {name: i for i, name in enumerate(self.capacities)}

    def capacity(self) -> Array:
        """Return the capacities, shape (N,) [J/K]."""
        return np.array(list(self.capacities.values()))

    def conductances(self, point: OperatingPoint) -> tuple[Array, Array]:
        """Return L (N, N) and G (N, M) at this operating point [W/K]."""
        node, edge = self.index(), {name: i for i, name in enumerate(self.boundaries)}
        between, to_boundary = np.zeros((len(node), len(node))), np.zeros((len(node), len(edge)))
        for link in self.links:
            a, g = node[link.a], link.W_per_K * link.film.factor(point)
            between[a, a] += g
            if link.b in edge:
                to_boundary[a, edge[link.b]] += g
            else:
                b = node[link.b]
                between[b, b] += g
                between[a, b] -= g
                between[b, a] -= g
        return between, to_boundary

    def step(self, point: OperatingPoint, period_s: float) -> Step:
        """Return the exact step of that length; each is computed once."""
        key = (point, period_s)
        if key not in self._steps:
            between, to_boundary = self.conductances(point)
            inverse = 1.0 / self.capacity()
            n = len(inverse)
            block = np.zeros((2 * n, 2 * n))  # exp of [[A, I], [0, 0]] t holds exp(A t) and its integral
            block[:n, :n] = -between * inverse[:, None]
            block[:n, n:] = np.eye(n)
            full = expm(block * period_s)
            integral = full[:n, n:] * inverse[None, :]
            self._steps[key] = Step(full[:n, :n].copy(), integral, integral @ to_boundary)
        return self._steps[key]

    def steady(self, point: OperatingPoint, power_W: Array, boundary_degC: Array) -> Array:
        """Return the temperatures (N,) that a long run at these inputs ends at."""
        between, to_boundary = self.conductances(point)
        return np.asarray(np.linalg.solve(between, power_W + to_boundary @ boundary_degC), dtype=np.float64)

    def run(
        self,
        start_degC: Array,
        points: list[OperatingPoint],
        which: NDArray[np.intp],
        power_W: Array,
        boundary_degC: Array,
        period_s: float,
    ) -> Array:
        """Integrate n held intervals.

        Parameters
        ----------
        start_degC : shape (N,)
        points : the operating points that occur
        which : index into `points` of each interval, shape (n,)
        power_W : heat into each node, shape (n, N)
        boundary_degC : shape (n, M)

        Returns
        -------
        temperatures at the start and after each interval, shape (n + 1, N) [°C]
        """
        steps = [self.step(point, period_s) for point in points]
        forced = np.empty_like(power_W)
        for k, step in enumerate(steps):
            at = which == k
            forced[at] = power_W[at] @ step.by_power.T + boundary_degC[at] @ step.by_boundary.T
        temperatures = np.empty((len(which) + 1, len(start_degC)))
        temperatures[0] = now = start_degC
        decays = [step.decay for step in steps]
        for i, k in enumerate(which):
            now = decays[k] @ now + forced[i]
            temperatures[i + 1] = now
        return temperatures
