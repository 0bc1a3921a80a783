"""Why a deviation is what it is: the share of each error term, of its thermal and of its geometric part.

To first order the deviation is a sum over the terms, G(q) e. What the exact chain adds to that sum is told apart, so
that nothing is left over.
"""

from __future__ import annotations

import numpy as np

from model.chain import Chain
from model.error_map import ErrorMap
from model.terms import UM
from model.transforms import Array
from service.schemas import Explanation, Share, TermShare, Vector

SMALLEST_UM = 0.001
"""A term none of whose parts is longer than this goes to the others [µm]: the 1 nm that compensation promises."""


def explain(
    chain: Chain, q: Array, tool_mm: Array | None, predicted: ErrorMap, geometric: ErrorMap, deviation_mm: Array
) -> list[Explanation]:
    """Return an explanation of each deviation.

    Parameters
    ----------
    q : shape (n, A), where the deviations are [mm]
    tool_mm : tool tip in the tool frame, shape (3,), by default the machine's
    predicted : the error map that the deviations come from; what it has besides `geometric` is the thermal part
    deviation_mm : shape (n, 3), of the exact chain
    """
    sensitivity = chain.sensitivity(q, tool_mm)[:, :3, :]
    cold, all_terms = geometric.evaluate(q), predicted.evaluate(q)
    parts = np.stack([cold, all_terms - cold], axis=1)  # (n, 2, K)
    shares = np.einsum("nik,npk->nkpi", sensitivity, parts) / UM  # (n, K, 2, 3)
    second = deviation_mm / UM - shares.sum(axis=(1, 2))
    names = [term.name for term in chain.machine.terms]
    return [_explanation(names, share, rest) for share, rest in zip(shares, second, strict=True)]


def _explanation(names: list[str], shares: Array, second_order: Array) -> Explanation:
    listed = np.linalg.norm(shares, axis=2).max(axis=1) >= SMALLEST_UM
    size = np.linalg.norm(shares.sum(axis=1), axis=1)
    order = [int(k) for k in np.argsort(-size, kind="stable") if listed[k]]
    geometric, thermal = shares[~listed].sum(axis=0)
    return Explanation(
        terms=[
            TermShare(term=names[k], geometric_um=vector(shares[k, 0]), thermal_um=vector(shares[k, 1])) for k in order
        ],
        others=Share(geometric_um=vector(geometric), thermal_um=vector(thermal)),
        second_order_um=vector(second_order),
    )


def vector(values: Array) -> Vector:
    """Return three numbers as they go over the wire."""
    x, y, z = values.tolist()
    return Vector(x=x, y=y, z=z)
