"""Parts that machines have in common, as capacities, links and heat: rods, screws, spindles, rotary drives, hulls.

Nodes are named by what they are: `spindle_front`, `spindle_rear`, `spindle_shaft`, and for an axis X `motor_x`,
`nut_x` or `motor_c`, `bearing_c`. Conductances given as defaults are chosen, as the designs' own are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi

from data_synth.heat import FeedSource, Law, PowerLaw, Source, StrokeSource
from data_synth.materials import (
    CAST_IRON,
    MOVING_FILM_W_PER_M2_K,
    STEEL,
    STILL_FILM_W_PER_M2_K,
    capacity,
    conductance,
)
from data_synth.network import Film, Link
from data_synth.screw import Screw

STEEL_KG_PER_M3 = 7850.0  # Incropera et al., appendix A, carbon and bearing steels: 7800 to 7854

FAN = Film(spindle=1.5)  # air stirred by what turns
SHAFT = Film(spindle=4.0)
SPLASH = Film(still=0.0, coolant=1.0)
DOOR = Film(door=3.0, coolant=0.3)
TURNING = Film(moving=MOVING_FILM_W_PER_M2_K / STILL_FILM_W_PER_M2_K - 1.0)


def air(node: str, to: str, area_m2: float, film: Film = Film()) -> Link:  # noqa: B008 (frozen)
    """Return the film of air over a surface."""
    return Link(node, to, STILL_FILM_W_PER_M2_K * area_m2, film)


def joined(node: str, to: Mapping[str, float], film: Film = Film()) -> list[Link]:  # noqa: B008 (frozen)
    """Return links from a node to others, by conductance [W/K]."""
    return [Link(node, other, W_per_K, film) for other, W_per_K in to.items()]


def iron(kg: Mapping[str, float]) -> dict[str, float]:
    """Return the capacities of castings of these masses [J/K]."""
    return {name: capacity(CAST_IRON, mass) for name, mass in kg.items()}


def steel(kg: Mapping[str, float]) -> dict[str, float]:
    """Return the capacities of steel parts of these masses [J/K]."""
    return {name: capacity(STEEL, mass) for name, mass in kg.items()}


@dataclass(frozen=True)
class Rod:
    """A round steel rod, such as a screw; or some of them side by side that do the same and count as one."""

    diameter_mm: float
    number: int = 1

    @property
    def section_m2(self) -> float:
        """Area of its section."""
        return self.number * pi * self.diameter_mm**2 / 4e6

    @property
    def girth_m(self) -> float:
        """Its circumference."""
        return self.number * pi * self.diameter_mm / 1e3

    @property
    def kg_per_m(self) -> float:
        """Mass per length."""
        return STEEL_KG_PER_M3 * self.section_m2


def screw_capacities(screw: Screw, rod: Rod) -> dict[str, float]:
    """Return the capacities of a screw's pieces [J/K]."""
    pieces_m = (b - a for a, b in zip(screw.edges_mm[:-1], screw.edges_mm[1:], strict=True))
    return {name: capacity(STEEL, rod.kg_per_m * mm / 1e3) for name, mm in zip(screw.nodes, pieces_m, strict=True)}


def screw_links(
    screw: Screw,
    rod: Rod,
    mount: Mapping[str, float],
    nut: Mapping[str, float],
    around: str,
    motor_end: int = -1,
) -> list[Link]:
    """Return a screw's links [W/K]: along it, to its motor and nut, theirs to what bears them, to the air around.

    Parameters
    ----------
    mount, nut : what the motor (with the fixed bearing) and the nut are bolted to
    motor_end : index of the screw's node beside the motor, 0 or -1
    """
    axis = screw.axis.lower()
    motor, piece_m = f"motor_{axis}", (screw.edges_mm[1] - screw.edges_mm[0]) / 1e3  # pieces are of one length
    along = conductance(STEEL, rod.section_m2, piece_m)
    links = [Link(a, b, along) for a, b in zip(screw.nodes[:-1], screw.nodes[1:], strict=True)]
    links += [air(node, around, rod.girth_m * piece_m, TURNING) for node in screw.nodes]
    links += [Link(screw.nodes[motor_end], motor, 2.0 * along), air(motor, around, 0.25)]
    links += joined(motor, mount) + joined(f"nut_{axis}", nut)
    return links + [Link(f"nut_{axis}", node, 0.3) for node in screw.nodes]  # by turns, over the stroke


def feed_sources(
    screw: Screw, guides: Mapping[str, float], motor: PowerLaw, nut: PowerLaw, guide: PowerLaw, into_screw: float = 0.45
) -> list[Source]:
    """Return the heat of a screw-driven axis: its motor, its nut (a share enters the screw), its guides by share."""
    axis = screw.axis.lower()
    return [
        FeedSource(screw.axis, motor, {f"motor_{axis}": 1.0}),
        FeedSource(screw.axis, nut, {f"nut_{axis}": 1.0 - into_screw}),
        StrokeSource(screw, nut, into_screw),
        FeedSource(screw.axis, guide, guides),
    ]


def spindle_links(
    front: Mapping[str, float],
    rear: Mapping[str, float],
    around: str,
    to_chiller: tuple[float, float] = (18.0, 12.0),
    to_shaft: tuple[float, float] = (7.0, 5.0),
) -> list[Link]:
    """Return a spindle's links [W/K]: bearings to the shaft, to the housings they sit in, to chiller and air.

    Parameters
    ----------
    front, rear : the housings
    to_chiller, to_shaft : from the front bearings and from the rear ones
    """
    return [
        Link("spindle_front", "spindle_shaft", to_shaft[0]),
        Link("spindle_rear", "spindle_shaft", to_shaft[1]),
        *joined("spindle_front", front),
        *joined("spindle_rear", rear),
        Link("spindle_front", "chiller", to_chiller[0]),
        Link("spindle_rear", "chiller", to_chiller[1]),
        air("spindle_front", around, 0.15, FAN),
        air("spindle_shaft", around, 0.10, SHAFT),
        Link("spindle_front", "coolant", 4.0, SPLASH),
    ]


def rotary_links(
    name: str, stands: Mapping[str, float], turns: Mapping[str, float], jacket_W_per_K: float = 0.0
) -> list[Link]:
    """Return a directly driven rotary bearing's links [W/K].

    Nodes `motor_<name>` (a stator, with its share of the rotor) and `bearing_<name>` sit between what stands and what
    turns; a name is that of an axis ("c"), or of one end of it ("a_left").

    Parameters
    ----------
    stands : to what stands, from the stator and once more from the bearing's ring
    turns : to what turns, through the rollers; a motor's air gap passes 0.4 of it (chosen)
    jacket_W_per_K : from the stator to the chiller, where it has a cooling jacket
    """
    motor, bearing = f"motor_{name}", f"bearing_{name}"
    links = [*joined(motor, stands), *joined(bearing, stands), *joined(bearing, turns)]
    links += joined(motor, {node: 0.4 * W_per_K for node, W_per_K in turns.items()})
    links.append(Link(motor, bearing, 4.0))
    return [*links, Link(motor, "chiller", jacket_W_per_K)] if jacket_W_per_K else links


def rotary_sources(
    axis: str, names: tuple[str, ...], motor: Law, bearing: Law, turns: Mapping[str, float]
) -> list[Source]:
    """Return the heat of a directly driven rotary axis by its speed [degree/min].

    Parameters
    ----------
    names : of its bearings with their motors, as in `rotary_links`; they share the heat alike
    turns : share of both laws' heat that the turning part takes at once (rotor, inner ring), by node
    """
    rest = (1.0 - sum(turns.values())) / len(names)
    return [
        FeedSource(axis, motor, {**{f"motor_{name}": rest for name in names}, **turns}),
        FeedSource(axis, bearing, {**{f"bearing_{name}": rest for name in names}, **turns}),
    ]


def hull_links(walls: Mapping[str, float], tank_W_per_K: float = 25.0, tank_air: str = "air_left") -> list[Link]:
    """Return the links of the nodes `enclosure` and `coolant` (its tank stands beside the machine) [W/K].

    Parameters
    ----------
    walls : from the enclosed air through the sheet metal to the air outside
    """
    return [
        Link("coolant", "enclosure", 10.0, Film(coolant=3.0)),
        Link("coolant", tank_air, tank_W_per_K),
        *joined("enclosure", walls, DOOR),
    ]
