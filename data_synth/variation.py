"""How one constant of a design becomes a sibling's: factors drawn by name, and the rules that apply them.

A factor is exp(spread z), z normal but never beyond `FURTHEST`, drawn from the design's name, the sibling's number and
the constant's own place in the design.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from data_synth.beam import Beam, Section, Vector
from data_synth.environment import BOUNDARIES
from data_synth.network import Link, Network

FURTHEST = 2.5
"""In spreads. A machine further off would not be delivered (chosen)."""
AIR = {name for name in BOUNDARIES if name.startswith("air")} | {"enclosure", "coolant"}
"""What a film lies towards; every other link is a contact or a wall."""

SPREADS: Mapping[str, float] = {
    "masses": 0.05,
    "contacts": 0.30,
    "films": 0.20,
    "heat": 0.20,
    "exponents": 0.03,
    "shares": 0.15,
    "lags": 0.20,
    "drives": 0.05,
    "preload": 0.15,
    "expansion": 0.02,
    "lengths": 0.01,
    "sections": 0.05,
    "workmanship": 0.20,
    "roundness": 0.30,
}
"""By kind of constant, of the logarithm, all chosen. Bolted joints differ most: their conductance follows a pressure
that nobody knows. A film follows paint and corners, friction follows grease and preload. Expansion differs as from
one melt to the next: GJL-300 has 10 to 11.5e-6 (see materials.py), steel 11.5 to 12e-6."""
BESIDE = 0.20
"""Largest share of its reading that a thermometer takes from a part beside its own (chosen)."""


@dataclass(frozen=True)
class Lot:
    """The draws of one sibling."""

    design: str
    number: int
    network: Network

    def draw(self, key: str) -> np.random.Generator:
        """Return the random numbers of that key."""
        return np.random.default_rng((zlib.crc32(self.design.encode()), self.number, zlib.crc32(key.encode())))

    def factor(self, key: str, kind: str) -> float:
        """Return the factor of that key."""
        z = np.clip(self.draw(key).standard_normal(), -FURTHEST, FURTHEST)
        return float(np.exp(SPREADS[kind] * z))

    def length(self, along: int) -> float:
        """Return the factor of all lengths along x, y or z, the same for the whole machine: what met still meets."""
        return self.factor("length along " + "xyz"[along], "lengths")


Rule = Callable[[Lot, str, Any, Any], Any]
"""From the lot, the constant's key, the constant and its owner to the sibling's constant."""


def kept(lot: Lot, key: str, value: Any, owner: Any) -> Any:
    """Return what all siblings have in common."""
    return value


def factor(kind: str) -> Rule:
    """Return the rule that gives a number its own factor; zero stays zero."""

    def rule(lot: Lot, key: str, value: float, owner: Any) -> float:
        return value * lot.factor(key, kind)

    return rule


def each(kind: str) -> Rule:
    """Return the rule that gives each entry of a table its own factor."""

    def rule(lot: Lot, key: str, value: Mapping[str, float], owner: Any) -> dict[str, float]:
        return {name: number * lot.factor(f"{key}.{name}", kind) for name, number in value.items()}

    return rule


def together(kind: str) -> Rule:
    """Return the rule that gives a table of vectors one factor: lengths that balance go on balancing."""

    def rule(lot: Lot, key: str, value: Mapping[str, Vector], owner: Any) -> dict[str, Vector]:
        f = lot.factor(key, kind)
        return {name: (f * x, f * y, f * z) for name, (x, y, z) in value.items()}

    return rule


def shares(lot: Lot, key: str, value: Mapping[str, float], owner: Any) -> dict[str, float]:
    """Return shares that differ but sum to what they summed to."""
    return _shared(lot, key, value)


def place(lot: Lot, key: str, value: Mapping[str, float], owner: Any) -> dict[str, float]:
    """Return what a thermometer feels that is fixed a little beside its place: towards a part linked to it."""
    felt = _shared(lot, key, value)
    main = max(value, key=lambda name: value[name])
    beside = [
        b if a == main else a
        for a, b in ((link.a, link.b) for link in lot.network.links)
        if main in (a, b) and a not in AIR and b not in AIR and main in lot.network.capacities
    ]
    if not beside:
        return felt
    draw = lot.draw(f"{key} beside")
    chosen, moved = beside[draw.integers(len(beside))], draw.uniform(0.0, BESIDE)
    felt = {name: share * (1.0 - moved) for name, share in felt.items()}
    felt[chosen] = felt.get(chosen, 0.0) + moved * sum(value.values())
    return felt


def melt(lot: Lot, key: str, value: float, owner: Any) -> float:
    """Return a coefficient of expansion: parts of one material are of one melt."""
    return value * lot.factor(f"expansion {value!r}", "expansion")


def conductance(lot: Lot, key: str, value: float, owner: Link) -> float:
    """Return a link's conductance, by whether it is a film."""
    return value * lot.factor(key, "films" if owner.a in AIR or owner.b in AIR else "contacts")


def phase(lot: Lot, key: str, value: float, owner: Any) -> float:
    """Return an angle [degree] that is as it happens: no two bearings are clamped alike."""
    return float(lot.draw(key).uniform(0.0, 360.0))


def held(lot: Lot, key: str, value: float, owner: Any) -> float:
    """Return a share between 0 and 1 that stays there."""
    odds = lot.factor(key, "preload")
    return value * odds / (1.0 - value + value * odds)


def point(lot: Lot, key: str, value: Vector | None, owner: Any) -> Vector | None:
    """Return a point of the machine."""
    if value is None:
        return None
    x, y, z = value
    return (x * lot.length(0), y * lot.length(1), z * lot.length(2))


def coordinate(lot: Lot, key: str, value: float, owner: Any) -> float:
    """Return a coordinate of a screw or scale, along itself."""
    return value * lot.length(owner.along)


def coordinates(lot: Lot, key: str, value: tuple[float, ...], owner: Any) -> tuple[float, ...]:
    """Return several of them."""
    return tuple(coordinate(lot, key, one, owner) for one in value)


def sections(lot: Lot, key: str, value: tuple[Section, ...], owner: Beam) -> tuple[Section, ...]:
    """Return a part's sections: places along it with the machine, offsets across by wall and rib of their own."""
    along = int(np.argmax(np.abs(owner.along)))
    across = [lot.length(k) * lot.factor(f"{key}.{'xyz'[k]}", "sections") for k in range(3)]
    return tuple(
        Section(
            section.at_mm * lot.length(along),
            {name: (x * across[0], y * across[1], z * across[2]) for name, (x, y, z) in section.nodes.items()},
        )
        for section in value
    )


def _shared(lot: Lot, key: str, value: Mapping[str, float]) -> dict[str, float]:
    drawn = {name: share * lot.factor(f"{key}.{name}", "shares") for name, share in value.items()}
    total = sum(drawn.values())
    return {name: share * sum(value.values()) / total for name, share in drawn.items()} if total else dict(value)
