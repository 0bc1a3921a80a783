"""A synthetic machine that warms up at one spindle speed, for tests of its time constants."""

import numpy as np

from data_synth.network import OperatingPoint
from data_synth.run import Shop


def warming(shop: Shop, rpm: float, hours: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes' rises over time in a hall of 20 °C, a row a minute, and what they end at."""
    design = shop.design
    nodes = design.network.nodes
    n = round(60 * hours)
    point = OperatingPoint(speed=rpm / design.capability.top_rpm)
    around = np.full((n, len(design.network.boundaries)), 20.0)
    power = np.zeros(len(nodes))
    for source in design.sources:
        if hasattr(source, "load_sensitivity"):
            for name, share in source.onto.items():
                power[nodes.index(name)] += share * source.law.power(np.array([rpm]))[0]
    path = design.network.run(
        np.full(len(nodes), 20.0), [point], np.zeros(n, dtype=np.intp), np.tile(power, (n, 1)), around, 60.0
    )
    return path - 20.0, design.network.steady(point, power, around[0]) - 20.0
