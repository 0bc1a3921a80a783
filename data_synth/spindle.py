"""The spindle: from the flange that holds it to the nose, which is the origin of the tool's frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from data_synth.displacement import Displacement
from data_synth.elastic import Elastic
from data_synth.fields import SPEED, SpeedShift
from data_synth.supports import Foot


@dataclass(frozen=True)
class Spindle:
    """A spindle in the body that carries the tool, in that body's frame; its nose is that frame's origin.

    Attributes
    ----------
    flange : where it is bolted to; it shifts and tilts with that place
    growth : its nodes with the lengths between flange and nose that they stand for [mm]
    """

    flange: Foot
    growth: Mapping[str, float]
    expansion_per_K: float
    speed_shift: SpeedShift

    def nose(self, carrier: Elastic, outwards: tuple[float, float, float], node: Mapping[str, int]) -> Displacement:
        """Return the displacement of the nose relative to the carrier's frame; `outwards` is where the tool points."""
        bolted = carrier.displacement(self.flange.at_mm, self.flange.on).carried(np.negative(self.flange.at_mm))
        shift = bolted.shift.copy()
        for name, length in self.growth.items():
            shift[0, :, node[name]] += self.expansion_per_K * length * np.array(outwards)
        if SPEED in node:
            shift[0, :, node[SPEED]] += np.array(outwards)
        return Displacement(shift, bolted.turn)
