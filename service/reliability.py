"""How much of the thermal part to apply: a weight between 0 and 1 for each reason to doubt it. Pure functions.

The thermal part is multiplied by the product of the weights, so it fades out and the geometric part stays.
"""

from __future__ import annotations

SHARE_FULL, SHARE_NONE = 0.25, 0.5
"""Share of replaced sensors up to which the thermal part counts in full, and from which it does not count at all.
Chosen: a quarter can be estimated well from the rest; with half of them gone the cause is likely one that the others
share. Where the bundle says what lost sensors cost (`model/reliability.py`), only the second holds."""
EDGE_K = 2.0
"""How far outside the trained range a temperature may be before the weight falls [K] (chosen)."""


def freshness_weight(age_s: float, stale_after_s: float, fade_s: float) -> float:
    """Return the weight of telemetry of that age: 1 until it is stale, then falling to 0 over `fade_s`."""
    return _falling(age_s, stale_after_s, stale_after_s + fade_s)


def replacement_weight(replaced: int, sensors: int) -> float:
    """Return the weight with that many of the sensors replaced by their estimates."""
    return _falling(replaced / sensors, SHARE_FULL, SHARE_NONE) if sensors else 1.0


def range_weight(beyond_K: float, width_K: float) -> float:
    """Return the weight of a temperature that far outside its trained range of that width.

    1 until `EDGE_K`, 0 from half the width: a range of 30 K carries 15 K further at most.
    """
    return _falling(beyond_K, EDGE_K, max(width_K / 2.0, 2.0 * EDGE_K))


def beyond(value: float, low: float, high: float) -> float:
    """Return how far a value is outside a range, 0 within it."""
    return max(low - value, value - high, 0.0)


def _falling(x: float, full: float, none: float) -> float:
    """Return 1 up to `full`, 0 from `none`, linear in between; 0 for NaN."""
    if x <= full:
        return 1.0
    return (none - x) / (none - full) if x < none else 0.0
