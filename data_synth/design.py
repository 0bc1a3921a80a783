"""A machine's thermal design: everything the shop has to know of it beyond its description."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from data_synth.capability import Capability
from data_synth.fields import Fields
from data_synth.geometric import NORMAL, Workmanship
from data_synth.heat import Source
from data_synth.network import Array, Network
from data_synth.programme import Programme
from data_synth.sensors import Thermometer
from model.machine import Machine


class Structure(Protocol):
    """How a machine's parts deform."""

    def fields(self, machine: Machine, node: Mapping[str, int], positions: int) -> Fields:
        """Return its error terms as functions of the nodes' temperatures."""


@dataclass(frozen=True)
class Design:
    """A thermal design, by the name of the machine it belongs to.

    Attributes
    ----------
    layering : how much of the climate's layering it feels; more than 1 for a machine that reaches higher up
    """

    name: str
    network: Network
    sources: tuple[Source, ...]
    structure: Structure
    thermometers: Mapping[str, Thermometer]
    capability: Capability
    workmanship: Workmanship = NORMAL
    layering: float = 1.0

    def heat(self, programme: Programme, conditions: Iterable[Array] | None = None) -> Array:
        """Return the heat into each node over a programme, shape (n, N) [W].

        `conditions` has a factor (n,) for each source; without it every source is as designed.
        """
        node = self.network.index()
        power = np.zeros((len(programme), len(node)))
        designed = itertools.repeat(np.ones(len(programme)), len(self.sources))
        for source, condition in zip(self.sources, conditions or designed, strict=True):
            source.add(power, programme, node, condition)
        return power
