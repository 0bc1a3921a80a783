"""Whether the compiled path computes on this computer what the chain says, checked at the start.

It was compiled for this processor, kept in a file and loaded again. Should any of that have gone wrong, no correction
is better than a wrong one.
"""

from __future__ import annotations

import numpy as np

from model.chain import Chain
from model.compensation import compensate
from model.error_map import ErrorMap
from model.exceptions import ComputeError
from model.machine import load_machine, preset
from model.transforms import Array

LARGEST_MM = 1e-6
"""How far the compensated tip may be from where it should be [mm]: the nanometre that compensation promises."""
POSITIONS = 150
"""More than two blocks of the compiled path, and a part of one."""


def check_compiled_path() -> None:
    """Compensate positions of a five-axis machine, and find with the plain chain where the tip then is.

    Raises
    ------
    ComputeError
        where that is not where it should be.
    """
    machine = load_machine(preset("trunnion5"))
    chain = Chain(machine)
    rng = np.random.default_rng(1)
    low, high = np.array([(machine.axes[a].low, machine.axes[a].high) for a in machine.axis_names]).T
    # Away from the pole of the tilting axis, where the orientation comes second.
    q = low + (high - low) * rng.uniform(0.55, 0.9, (POSITIONS, len(low)))
    errors = _drawn(ErrorMap.zero(machine), rng)
    corrected = compensate(chain, q, errors).corrected
    gap = chain.tip(corrected, errors.evaluate(corrected)) - chain.tip(q)
    if not np.abs(gap).max() <= LARGEST_MM:  # NaN fails, too
        raise ComputeError(
            f"the compiled path must put the tip within {LARGEST_MM:g} mm of where it should be, got "
            f"{np.abs(gap).max():.3g} mm; remove what is kept of it, in NUMBA_CACHE_DIR or in __pycache__ beside "
            "model/kernel.py"
        )


def _drawn(zero: ErrorMap, rng: np.random.Generator) -> ErrorMap:
    """Return terms of the size of real ones: 20 µm, 20 µrad."""
    machine = zero.machine
    knots = {a: np.linspace(machine.axes[a].low, machine.axes[a].high, 7) for a in machine.axis_names}
    motion: dict[str, Array] = {a: rng.normal(0.0, 0.02, (6, 7)) for a in machine.axis_names}
    for terms in motion.values():
        terms[3:] *= 1e-3
    angular = np.array([t.angular for t in machine.terms if t.kind == "location"])
    location = rng.normal(0.0, 0.02, len(angular)) * np.where(angular, 1e-3, 1.0)
    return ErrorMap(machine, knots, motion, location)
