"""The error budget: how much each error term contributes to the tip's deviation over the working volume.

To first order the deviation is a sum, δ = Σ G_k(q) e_k, so each term has its own part of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.chain import Chain
from model.error_map import ErrorMap
from model.machine import Machine
from model.term_classes import TermClass, principal_terms, term_class
from model.terms import UM, URAD, Term
from model.transforms import Array

UNIT_UM, UNIT_URAD = 10.0, 10.0
"""Size of a term of which nothing is known [µm, µrad]: that of a good machine's (chosen, not measured)."""
LOCATION_SHARE = 0.005
"""Size of a secondary location term relative to that: the paper reports two to three orders of magnitude less."""
CHUNK = 4096
"""Points worked on at once: about 12 MB for a machine of 60 terms."""


@dataclass(frozen=True)
class Contribution:
    """One term's part in the deviation.

    Attributes
    ----------
    size : root mean square of the term itself over the working volume [µm or µrad]
    tip_um : root mean square of the displacement of the tip that the term alone makes
    tilt_urad : the same of the tool's orientation
    share : part of the mean square displacement. Of independent terms, all positive; of an error table's values,
        the mean of the term's part times the whole deviation, negative for a term that makes up for others. The
        shares of all terms add up to 1
    """

    term: Term
    term_class: TermClass
    size: float
    tip_um: float
    tilt_urad: float
    share: float


@dataclass(frozen=True)
class Budget:
    """All contributions, the largest first, and the root mean square of all together."""

    contributions: tuple[Contribution, ...]
    tip_um: float
    tilt_urad: float

    def count(self, name: TermClass) -> int:
        """Return how many terms are of that class."""
        return sum(c.term_class == name for c in self.contributions)

    def share(self, name: TermClass) -> float:
        """Return the share of all terms of that class together."""
        return sum(c.share for c in self.contributions if c.term_class == name)


def unit_errors(machine: Machine, location_share: float = LOCATION_SHARE) -> Array:
    """Return the standard uncertainty of each term where nothing is known, shape (K,) [mm, rad]."""
    principal = principal_terms(machine)
    return np.array(
        [
            (UNIT_URAD if t.angular else UNIT_UM) * t.to_internal * (1.0 if t.name in principal else location_share)
            for t in machine.terms
        ]
    )


def spread(machine: Machine, points: int) -> Array:
    """Return positions that fill the working volume evenly, shape (points, A) [mm, degree].

    The additive recurrence of M. Roberts (2018), "The unreasonable effectiveness of quasirandom sequences": the
    same points each time, and evener than random ones.
    """
    axes = [machine.axes[a] for a in machine.axis_names]
    ratio = 2.0
    for _ in range(64):  # the root of x^(A+1) = x + 1
        ratio = (1.0 + ratio) ** (1.0 / (len(axes) + 1))
    steps = ratio ** -np.arange(1.0, len(axes) + 1)
    unit = np.mod(0.5 + np.outer(np.arange(1.0, points + 1), steps), 1.0)
    low, high = np.array([a.low for a in axes]), np.array([a.high for a in axes])
    return np.asarray(low + unit * (high - low), dtype=float)


def budget(
    chain: Chain,
    errors: ErrorMap | None = None,
    *,
    tool_mm: Array | None = None,
    points: int = 4096,
    location_share: float = LOCATION_SHARE,
) -> Budget:
    """Rank the error terms by the displacement of the tip that each alone makes over the working volume.

    Parameters
    ----------
    errors : values of the terms; without them, independent ones of `unit_errors`
    tool_mm : tool tip in the tool frame, shape (3,), by default the machine's
    points : how many positions stand for the volume
    location_share : see `LOCATION_SHARE`; only used without `errors`
    """
    machine = chain.machine
    count = len(machine.terms)
    size, tip, tilt, common = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count)
    whole = np.zeros(2)
    sample = spread(machine, points)
    for start in range(0, points, CHUNK):
        q = sample[start : start + CHUNK]
        e = errors.evaluate(q) if errors is not None else np.tile(unit_errors(machine, location_share), (len(q), 1))
        parts = chain.sensitivity(q, tool_mm) * e[:, None, :]
        size += np.square(e).sum(axis=0)
        tip += np.square(parts[:, :3]).sum(axis=(0, 1))
        tilt += np.square(parts[:, 3:]).sum(axis=(0, 1))
        total = parts.sum(axis=2)
        common += np.einsum("nik,ni->k", parts[:, :3], total[:, :3])
        whole += [np.square(total[:, :3]).sum(), np.square(total[:, 3:]).sum()]
    if errors is None:  # of independent terms, variances add
        common, whole = tip, np.array([tip.sum(), tilt.sum()])
    share = common / common.sum() if whole[0] > 0.0 else np.zeros(count)
    classes = term_class(machine)
    found = [
        Contribution(
            term,
            classes[term.name],
            float(np.sqrt(size[k] / points) / term.to_internal),
            float(np.sqrt(tip[k] / points) / UM),
            float(np.sqrt(tilt[k] / points) / URAD),
            float(share[k]),
        )
        for k, term in enumerate(machine.terms)
    ]
    # Rounded, so that equal contributions stay in the machine's order.
    ranked = tuple(sorted(found, key=lambda c: (-round(c.tip_um, 9), -round(c.tilt_urad, 9))))
    return Budget(ranked, float(np.sqrt(whole[0] / points) / UM), float(np.sqrt(whole[1] / points) / URAD))
