"""Materials of a machine tool and the few laws of heat that its constants rest on.

Sources
-------
[inc] Incropera, DeWitt, Bergman, Lavine, Fundamentals of Heat and Mass Transfer, appendix A
[vdi] VDI Heat Atlas, sections on natural convection and on radiation
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Material:
    """A solid.

    Attributes
    ----------
    expansion_per_K : linear coefficient of thermal expansion
    heat_J_per_kg_K : specific heat
    """

    expansion_per_K: float
    heat_J_per_kg_K: float
    conductivity_W_per_m_K: float


CAST_IRON = Material(10.5e-6, 500.0, 50.0)  # grey iron GJL-300, EN 1561 annex: 10 to 11.5e-6, 460 to 535, 45 to 50
STEEL = Material(11.7e-6, 460.0, 45.0)  # bearing and screw steel, [inc]: 11.5 to 12e-6, 434 to 477, 40 to 60

LINING_PER_K = 4e-5  # moulded epoxy slideway lining; filled epoxies 30 to 60e-6 (chosen within)

COOLANT_J_PER_KG_K = 4000.0  # 5 % emulsion, close to water's 4180 [inc]

STILL_FILM_W_PER_M2_K = 8.0  # natural convection 3 to 5 and radiation 5, painted walls near 20 °C [vdi]
MOVING_FILM_W_PER_M2_K = 25.0  # a screw turning at some hundred rpm, forced convection 10 to 100 [inc]


def conductance(material: Material, area_m2: float, length_m: float) -> float:
    """Return k A / L of a straight path [W/K] (Fourier)."""
    return material.conductivity_W_per_m_K * area_m2 / length_m


def capacity(material: Material, mass_kg: float) -> float:
    """Return m c [J/K]."""
    return material.heat_J_per_kg_K * mass_kg
