"""Homogeneous transforms of rigid bodies, batched over poses.

`b_T_a` maps coordinates in frame a to coordinates in frame b, so that names cancel under `@`:
`work_T_tool = work_T_bed @ bed_T_tool`. Lengths in mm, angles in rad.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rotation(alpha: Array, beta: Array, gamma: Array) -> Array:
    """Return R = Rx(α) Ry(β) Rz(γ), the rotation part of eq. (1) and (2) of Su, Li and Wang (2001).

    Rows 2 and 3 are printed wrong in the paper; this is the product itself.

    Parameters
    ----------
    alpha, beta, gamma : arrays of one shape (...) [rad]

    Returns
    -------
    array of shape (..., 3, 3)
    """
    sa, ca = np.sin(alpha), np.cos(alpha)
    sb, cb = np.sin(beta), np.cos(beta)
    sg, cg = np.sin(gamma), np.cos(gamma)
    return np.stack(
        [
            np.stack([cb * cg, -cb * sg, sb], axis=-1),
            np.stack([ca * sg + sa * sb * cg, ca * cg - sa * sb * sg, -sa * cb], axis=-1),
            np.stack([sa * sg - ca * sb * cg, sa * cg + ca * sb * sg, ca * cb], axis=-1),
        ],
        axis=-2,
    )


def skew(vector: Array) -> Array:
    """Return the matrix S with S @ r = vector x r; vector of shape (..., 3), result (..., 3, 3)."""
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    return np.stack(
        [
            np.stack([zero, -z, y], axis=-1),
            np.stack([z, zero, -x], axis=-1),
            np.stack([-y, x, zero], axis=-1),
        ],
        axis=-2,
    )


def exact_error(e: Array) -> Array:
    """Return the error transform of eq. (2), trigonometric.

    Parameters
    ----------
    e : shape (n, 6), displacement x, y, z [mm] and angles α, β, γ [rad]

    Returns
    -------
    array of shape (n, 4, 4)
    """
    return _assemble(rotation(e[:, 3], e[:, 4], e[:, 5]), e[:, :3])


def small_angle_error(e: Array) -> Array:
    """Return the error transform of eq. (3), in which sines are angles and cosines one; as `exact_error`."""
    return _assemble(np.eye(3) + skew(e[:, 3:]), e[:, :3])


def translation(offset: Array) -> Array:
    """Return the translation by `offset`; shape (n, 3) gives (n, 4, 4), (3,) gives (4, 4)."""
    return _assemble(np.broadcast_to(np.eye(3), (*offset.shape[:-1], 3, 3)), offset)


def turn(angle: Array, direction: Array) -> Array:
    """Return the rotation by `angle` (n,) [rad] about the unit vector `direction` (3,), shape (n, 4, 4).

    Rodrigues' formula.
    """
    cross = skew(direction)
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    rotated = np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)
    return _assemble(rotated, np.zeros((len(angle), 3)))


def apply(b_T_a: Array, point: Array) -> Array:
    """Return the point (..., 3), given in frame a, in frame b."""
    moved: Array = (b_T_a[..., :3, :3] @ point[..., None])[..., 0] + b_T_a[..., :3, 3]
    return moved


def apply_inverse(b_T_a: Array, point: Array) -> Array:
    """Return the point (..., 3), given in frame b, in frame a.

    Solves with the matrix itself, so it also inverts the small-angle form, which is not orthogonal.
    """
    solved = np.linalg.solve(b_T_a[..., :3, :3], (point - b_T_a[..., :3, 3])[..., None])[..., 0]
    return np.asarray(solved, dtype=float)


def rotation_vector(rotation_matrix: Array) -> Array:
    """Return the rotation vector (axis times angle) of rotations by less than half a turn.

    Parameters
    ----------
    rotation_matrix : shape (n, 3, 3)

    Returns
    -------
    array of shape (n, 3) [rad]
    """
    m = rotation_matrix
    vector = 0.5 * np.stack([m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]], axis=-1)
    sine: Array = np.asarray(np.linalg.norm(vector, axis=-1), dtype=float)
    cosine = 0.5 * (np.trace(m, axis1=1, axis2=2) - 1.0)
    angle = np.arctan2(sine, cosine)
    # angle / sin(angle) tends to 1; below 1e-8 rad the quotient is 1 to double precision.
    factor = np.where(sine > 1e-8, angle / np.where(sine > 1e-8, sine, 1.0), 1.0)
    scaled: Array = vector * factor[:, None]
    return scaled


def _assemble(rotation_matrix: Array, offset: Array) -> Array:
    transform = np.zeros((*offset.shape[:-1], 4, 4))
    transform[..., :3, :3] = rotation_matrix
    transform[..., :3, 3] = offset
    transform[..., 3, 3] = 1.0
    return transform
