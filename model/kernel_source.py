"""The per-position path, compiled: a block of positions at a time through a machine's plan.

A plan (`kernel_plan.py`) is a list of operations that carry the tool tip from the tool's frame down to the bed and up
to the workpiece. Each operation is a loop over the `LANES` positions of a block, which the compiler turns into vector
instructions: no loop that should be one both stores and looks up a table, since nobody can prove that the two do not
overlap.

`w` is the workspace, rows of `LANES` numbers; `c` holds the coordinates, a row per axis. mm and rad, rotary
coordinates in degrees.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numba import carray, types  # type: ignore[attr-defined]

from model.kernel_constants import (
    AFFINE,
    ALONG,
    AXIS,
    BEFORE,
    CLOSE,
    CONVERGED_MM,
    CONVERGED_RAD,
    EASING,
    ERROR,
    ERROR_BACK,
    FOLLOWING,
    FREE,
    LANES,
    LINEAR,
    MAX_ITERATIONS,
    MISS,
    RESTING,
    ROTARY,
    ROW,
    SHIFT,
    SINES,
    SINGULAR,
    SLACK_RAD,
    SLIDE,
    TILT,
    TIP,
    TURN,
    VALUES,
    WANTED_AXIS,
    WANTED_TIP,
    rows,
)

# Contracting a multiplication and an addition keeps numbers that are not numbers as they are; other liberties do not.
OPTIONS: dict[str, Any] = {"nogil": True, "fastmath": {"contract"}, "error_model": "numpy"}
compiled: Any = numba.njit(**OPTIONS)
rows_of = compiled(rows)

RAD = np.pi / 180.0
B = LANES
ROW_ON = np.uint64(ROW)
U1, U2, U3, U4, U5, U6, U7, U8, U9, U10, U11, U12 = (np.uint64(k) for k in range(1, 13))


@compiled
def _look_up(w, c, rows, axis, cells, segments, first_cell, first_row, steps, low, per_mm, top):
    """Put the six motion terms of an axis into the rows `VALUES`: linear between knots, constant beyond them."""
    for i in range(B):
        cell = (c[axis * B + i] - low) * per_mm
        cell = cell if cell > 0.0 else 0.0  # also where it is not a number
        cell = cell if cell < top else top
        rows[i] = first_row + cells[first_cell + np.int32(cell)] * ROW
    for _ in range(steps):  # the knots within a cell; nearly always one
        for i in range(B):
            row = rows[i]  # unsigned, as an index below zero would be looked at for wrapping around
            rows[i] = row + ROW_ON if c[axis * B + i] >= segments[row + ROW_ON] else row
    for i in range(B):
        row = rows[i]
        t = c[axis * B + i] - segments[row]
        w[VALUES * B + i] = segments[row + U1] + t * segments[row + U7]
        w[(VALUES + 1) * B + i] = segments[row + U2] + t * segments[row + U8]
        w[(VALUES + 2) * B + i] = segments[row + U3] + t * segments[row + U9]
        w[(VALUES + 3) * B + i] = segments[row + U4] + t * segments[row + U10]
        w[(VALUES + 4) * B + i] = segments[row + U5] + t * segments[row + U11]
        w[(VALUES + 5) * B + i] = segments[row + U6] + t * segments[row + U12]


@compiled
def _small_sines(w):
    """Put sine and cosine of the three error angles into the rows `SINES`: Taylor, exact in double up to 0.1 rad."""
    for k in range(3):
        for i in range(B):
            a = w[(VALUES + 3 + k) * B + i]
            z = a * a
            w[(SINES + 2 * k) * B + i] = a * (
                1.0 - z * (1 / 6) * (1.0 - z * (1 / 20) * (1.0 - z * (1 / 42) * (1.0 - z * (1 / 72))))
            )
            w[(SINES + 2 * k + 1) * B + i] = 1.0 - z * 0.5 * (
                1.0 - z * (1 / 12) * (1.0 - z * (1 / 30) * (1.0 - z * (1 / 56)))
            )


@compiled
def _turn_by_error(w, row):
    """Turn a vector by Rx(α) Ry(β) Rz(γ) of the rows `SINES`, eq. (2)."""
    for i in range(B):
        x, y, z = w[row * B + i], w[(row + 1) * B + i], w[(row + 2) * B + i]
        s, c = w[(SINES + 4) * B + i], w[(SINES + 5) * B + i]
        u = c * x - s * y
        v = s * x + c * y
        s, c = w[(SINES + 2) * B + i], w[(SINES + 3) * B + i]
        w[row * B + i] = c * u + s * z
        z = c * z - s * u
        s, c = w[SINES * B + i], w[(SINES + 1) * B + i]
        w[(row + 1) * B + i] = c * v - s * z
        w[(row + 2) * B + i] = s * v + c * z


@compiled
def _turn_back_by_error(w, row):
    """Turn a vector by the inverse of Rx(α) Ry(β) Rz(γ)."""
    for i in range(B):
        x, y, z = w[row * B + i], w[(row + 1) * B + i], w[(row + 2) * B + i]
        s, c = w[SINES * B + i], w[(SINES + 1) * B + i]
        v = c * y + s * z
        z = c * z - s * y
        s, c = w[(SINES + 2) * B + i], w[(SINES + 3) * B + i]
        u = c * x - s * z
        w[(row + 2) * B + i] = c * z + s * x
        s, c = w[(SINES + 4) * B + i], w[(SINES + 5) * B + i]
        w[row * B + i] = c * u + s * v
        w[(row + 1) * B + i] = c * v - s * u


@compiled
def _shift_by_error(w, sign):
    for k in range(3):
        for i in range(B):
            w[(TIP + k) * B + i] += sign * w[(VALUES + k) * B + i]


@compiled
def _axis_sines(w, c, axis):
    """Put sine and cosine of a rotary coordinate [degree] into the first rows of `SINES`.

    Reduced to ±45 degrees, where a remainder in degrees is exact, then the polynomials of the Cephes library.
    """
    for i in range(B):
        x = c[axis * B + i]
        quarter = np.floor(x * (1.0 / 90.0) + 0.5)
        a = (x - 90.0 * quarter) * RAD
        z = a * a
        sine = 1.58962301576546568060e-10 * z - 2.50507477628578072866e-8
        sine = (sine * z + 2.75573136213857245213e-6) * z - 1.98412698295895385996e-4
        sine = (sine * z + 8.33333333332211858878e-3) * z - 1.66666666666666307295e-1
        sine = a + a * z * sine
        cosine = -1.13585365213876817300e-11 * z + 2.08757008419747316778e-9
        cosine = (cosine * z - 2.75573141792967388112e-7) * z + 2.48015872888517045348e-5
        cosine = (cosine * z - 1.38888888888730564116e-3) * z + 4.16666666666665929218e-2
        cosine = 1.0 - 0.5 * z + z * z * cosine
        m = quarter - 4.0 * np.floor(quarter * 0.25)  # 0, 1, 2 or 3
        odd = (m == 1.0) | (m == 3.0)
        s = cosine if odd else sine
        k = sine if odd else cosine
        w[SINES * B + i] = -s if m >= 2.0 else s
        w[(SINES + 1) * B + i] = -k if (m == 1.0) | (m == 2.0) else k


@compiled
def _turn_about(w, row, sign, x, y, z):
    """Turn a vector about the unit vector (x, y, z) by sign times the angle of `_axis_sines`; Rodrigues' formula."""
    for i in range(B):
        s, c = sign * w[SINES * B + i], w[(SINES + 1) * B + i]
        a, b, d = w[row * B + i], w[(row + 1) * B + i], w[(row + 2) * B + i]
        along = (a * x + b * y + d * z) * (1.0 - c)
        w[row * B + i] = c * a + s * (y * d - z * b) + along * x
        w[(row + 1) * B + i] = c * b + s * (z * a - x * d) + along * y
        w[(row + 2) * B + i] = c * d + s * (x * b - y * a) + along * z


@compiled
def _affine(w, row, k, moves):
    """Apply a constant rigid motion: the rotation k[0:9] by rows, and for a point the shift k[9:12]."""
    k0, k1, k2, k3, k4, k5, k6, k7, k8 = k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8]
    s0, s1, s2 = moves * k[9], moves * k[10], moves * k[11]
    for i in range(B):
        a, b, d = w[row * B + i], w[(row + 1) * B + i], w[(row + 2) * B + i]
        w[row * B + i] = k0 * a + k1 * b + k2 * d + s0
        w[(row + 1) * B + i] = k3 * a + k4 * b + k5 * d + s1
        w[(row + 2) * B + i] = k6 * a + k7 * b + k8 * d + s2


@compiled
def _shift(w, k):
    s0, s1, s2 = k[9], k[10], k[11]
    for i in range(B):
        w[TIP * B + i] += s0
        w[(TIP + 1) * B + i] += s1
        w[(TIP + 2) * B + i] += s2


@compiled
def _slide(w, c, axis, x, y, z):
    for i in range(B):
        q = c[axis * B + i]
        w[TIP * B + i] += q * x
        w[(TIP + 1) * B + i] += q * y
        w[(TIP + 2) * B + i] += q * z


@compiled
def _set(w, row, x, y, z):
    for i in range(B):
        w[row * B + i] = x
        w[(row + 1) * B + i] = y
        w[(row + 2) * B + i] = z


@compiled
def _begin_rotary(w, position, spin, sign, x, y, z):
    """Let the columns of a rotary axis begin: how the tip moves with it, and the vector it turns about."""
    for i in range(B):
        a, b, d = w[TIP * B + i], w[(TIP + 1) * B + i], w[(TIP + 2) * B + i]
        w[position * B + i] = sign * (y * d - z * b)
        w[(position + 1) * B + i] = sign * (z * a - x * d)
        w[(position + 2) * B + i] = sign * (x * b - y * a)
    _set(w, spin, sign * x, sign * y, sign * z)


@compiled
def _real_pass(w, c, found, ops, constants, cells, segments, lookup, grid, tool, with_axis):
    """Carry the tip, and the tool axis if asked, through the erroneous chain."""
    _set(w, TIP, tool[0], tool[1], tool[2])
    _set(w, AXIS, tool[3], tool[4], tool[5])
    for o in range(len(ops)):
        kind, axis = ops[o, 0], ops[o, 1]
        k = constants[o]
        if kind in (ERROR, ERROR_BACK):
            first_cell, first_row, steps = lookup[axis, 0], lookup[axis, 1], lookup[axis, 2]
            low, per_mm, top = grid[axis, 0], grid[axis, 1], grid[axis, 2]
            _look_up(w, c, found, axis, cells, segments, first_cell, first_row, steps, low, per_mm, top)
            _small_sines(w)
            if kind == ERROR:
                _turn_by_error(w, TIP)
                _shift_by_error(w, 1.0)
                if with_axis:
                    _turn_by_error(w, AXIS)
            else:
                _shift_by_error(w, -1.0)
                _turn_back_by_error(w, TIP)
                if with_axis:
                    _turn_back_by_error(w, AXIS)
        elif kind == AFFINE:
            _affine(w, TIP, k, 1.0)
            if with_axis:
                _affine(w, AXIS, k, 0.0)
        elif kind == SLIDE:
            _slide(w, c, axis, k[0], k[1], k[2])
        elif kind == TURN:
            _axis_sines(w, c, axis)
            _turn_about(w, TIP, k[3], k[0], k[1], k[2])
            if with_axis:
                _turn_about(w, AXIS, k[3], k[0], k[1], k[2])
        else:
            _shift(w, k)


@compiled
def _ideal_pass(w, c, ops, constants, tool, linear, rotary, active):
    """Carry the tip and the tool axis through the ideal chain, and with them the vectors that the axes begin.

    Vectors from `FREE` on, three rows each: a column (or, where the columns are constant on the bed, a row of their
    inverse) of each free linear axis; then of each free rotary axis how it moves the tip, and what it turns about.
    """
    _set(w, TIP, tool[0], tool[1], tool[2])
    _set(w, AXIS, tool[3], tool[4], tool[5])
    count = linear + 2 * rotary
    active[:count] = 0
    for o in range(len(ops)):
        kind, axis, begins, vector = ops[o, 0], ops[o, 1], ops[o, 2], ops[o, 3]
        k = constants[o]
        if kind == SHIFT:
            _shift(w, k)
        elif kind == SLIDE:
            _slide(w, c, axis, k[0], k[1], k[2])
        elif kind == TURN:
            _axis_sines(w, c, axis)
            _turn_about(w, TIP, k[3], k[0], k[1], k[2])
            _turn_about(w, AXIS, k[3], k[0], k[1], k[2])
            for v in range(count):
                if active[v]:
                    _turn_about(w, FREE + 3 * v, k[3], k[0], k[1], k[2])
            if begins == ROTARY:
                position, spin = linear + vector, linear + rotary + vector
                _begin_rotary(w, FREE + 3 * position, FREE + 3 * spin, k[3], k[0], k[1], k[2])
                active[position] = 1
                active[spin] = 1
        if begins == LINEAR:
            _set(w, FREE + 3 * vector, k[0], k[1], k[2])
            active[vector] = 1


@compiled
def _solve_rotary(w, linear, rotary):
    """Put the rotary axes' inverse into the rows after the free vectors; return the least effect squared.

    With b the vectors that the rotary axes turn about, less their part along the tool axis, the inverse is
    bᵀ h(b bᵀ) with h(λ) = 1 / max(λ, SINGULAR²): the pseudo-inverse, in which what hardly turns the tool axis fades
    out, bounded and continuous. In the plane across the tool axis b bᵀ is 2 x 2, and h has a closed form.
    """
    spin = FREE + 3 * (linear + rotary)
    inverse = FREE + 3 * (linear + 2 * rotary)
    product = inverse + 3 * rotary
    limit = SINGULAR * SINGULAR
    least = 1.0
    for i in range(B):
        ax, ay, az = w[WANTED_AXIS * B + i], w[(WANTED_AXIS + 1) * B + i], w[(WANTED_AXIS + 2) * B + i]
        # Two unit vectors across the axis (Duff et al., J. Comput. Graph. Tech. 6 (2017) 1).
        s = 1.0 if az >= 0.0 else -1.0
        f = -1.0 / (s + az)
        g = ax * ay * f
        ux, uy, uz = 1.0 + s * ax * ax * f, s * g, -s * ax
        vx, vy, vz = g, s + ay * ay * f, -ay
        n11 = n12 = n22 = 0.0
        for r in range(rotary):
            at = (spin + 3 * r) * B + i
            x, y, z = w[at], w[at + B], w[at + 2 * B]
            p, q = ux * x + uy * y + uz * z, vx * x + vy * y + vz * z
            n11 += p * p
            n12 += p * q
            n22 += q * q
        mean, half = 0.5 * (n11 + n22), 0.5 * (n11 - n22)
        d = np.sqrt(half * half + n12 * n12)
        high, low = mean + d, mean - d
        low = low if low > 0.0 else 0.0
        h_high = 1.0 / (high if high > limit else limit)
        h_low = 1.0 / (low if low > limit else limit)
        slope = (h_high - h_low) / (high - low) if high - low > 1e-12 else 0.0
        h11 = h_low + slope * (n11 - low)
        h12 = slope * n12
        h22 = h_low + slope * (n22 - low)
        effect = low if rotary > 1 else high
        least = effect if effect < least else least
        for r in range(rotary):
            at = (spin + 3 * r) * B + i
            x, y, z = w[at], w[at + B], w[at + 2 * B]
            p, q = ux * x + uy * y + uz * z, vx * x + vy * y + vz * z
            p, q = h11 * p + h12 * q, h12 * p + h22 * q
            x, y, z = p * ux + q * vx, p * uy + q * vy, p * uz + q * vz
            to = (inverse + 3 * r) * B + i
            w[to], w[to + B], w[to + 2 * B] = x, y, z
            for t in range(rotary):
                at = (spin + 3 * t) * B + i
                w[(product + r * rotary + t) * B + i] = x * w[at] + y * w[at + B] + z * w[at + 2 * B]
    return least


@compiled
def _diagonalise(n, e):
    """Turn the symmetric matrix n (3, 3) into its eigenvalues, on the diagonal, and e into its eigenvectors.

    Jacobi's rotations; four sweeps leave nothing of a 3 x 3.
    """
    for k in range(12):
        p, q = (k % 3, k % 3 + 1) if k % 3 < 2 else (0, 2)
        if abs(n[p, q]) > 0.0:
            theta = 0.5 * np.arctan2(2.0 * n[p, q], n[p, p] - n[q, q])
            s, c = np.sin(theta), np.cos(theta)
            for m in range(3):
                n[p, m], n[q, m] = c * n[p, m] + s * n[q, m], c * n[q, m] - s * n[p, m]
            for m in range(3):
                n[m, p], n[m, q] = c * n[m, p] + s * n[m, q], c * n[m, q] - s * n[m, p]
                e[m, p], e[m, q] = c * e[m, p] + s * e[m, q], c * e[m, q] - s * e[m, p]


@compiled
def _invert_linear(w, linear, rotary, n, e):
    """Turn the columns of the linear axes into rows of their faded inverse, Jᵀ h(J Jᵀ); the columns move behind.

    Only where a rotary axis carries a linear one. n, e : scratch, shape (3, 3)
    """
    columns = FREE + 3 * (linear + 2 * rotary) + 3 * rotary + rotary * rotary
    for row in range(3 * linear):
        for i in range(B):
            w[(columns + row) * B + i] = w[(FREE + row) * B + i]
    for i in range(B):
        for k in range(3):
            for m in range(3):
                e[k, m] = 1.0 if k == m else 0.0
                n[k, m] = 0.0
                for v in range(linear):
                    n[k, m] += w[(columns + 3 * v + k) * B + i] * w[(columns + 3 * v + m) * B + i]
        _diagonalise(n, e)
        for row in range(3 * linear):
            w[(FREE + row) * B + i] = 0.0
        for v in range(linear):
            at = columns + 3 * v
            for m in range(3):
                along = e[0, m] * w[at * B + i] + e[1, m] * w[(at + 1) * B + i] + e[2, m] * w[(at + 2) * B + i]
                along /= max(n[m, m], SINGULAR * SINGULAR)
                for k in range(3):
                    w[(FREE + 3 * v + k) * B + i] += e[k, m] * along


@compiled
def _miss(w):
    """Put what the tip is off, and the vector that would turn the tool axis back, into their rows."""
    for k in range(3):
        for i in range(B):
            w[(MISS + k) * B + i] = w[(TIP + k) * B + i] - w[(WANTED_TIP + k) * B + i]
    for i in range(B):
        a, b, d = w[AXIS * B + i], w[(AXIS + 1) * B + i], w[(AXIS + 2) * B + i]
        x, y, z = w[WANTED_AXIS * B + i], w[(WANTED_AXIS + 1) * B + i], w[(WANTED_AXIS + 2) * B + i]
        w[TILT * B + i] = b * z - d * y
        w[(TILT + 1) * B + i] = d * x - a * z
        w[(TILT + 2) * B + i] = a * y - b * x


@compiled
def _limit(w, step, rotary):
    """Shorten the way that the rotary axes are to go from the programmed pose to what is bounded; return where."""
    count = 0
    for i in range(B):
        length = 0.0
        for r in range(rotary):
            length += w[(step + r) * B + i] * w[(step + r) * B + i]
        most = 2.0 * np.sqrt(w[BEFORE * B + i]) / SINGULAR + SLACK_RAD
        too_long = length > most * most
        count += 1 if too_long else 0
        factor = most / np.sqrt(length) if too_long else 1.0
        for r in range(rotary):
            w[(step + r) * B + i] *= factor
    return count


@compiled
def _come_to_rest(w, step, gone, rotary):
    """Let the rotary axes stay where they are, or go back where they found no place and the tool is tilted more."""
    for i in range(B):
        tilt = length = swing = 0.0
        for k in range(3):
            tilt += w[(TILT + k) * B + i] * w[(TILT + k) * B + i]
        for r in range(rotary):
            length += w[(step + r) * B + i] * w[(step + r) * B + i]
            swing = max(swing, abs(w[(step + r) * B + i] - w[(gone + r) * B + i]))
        most = 2.0 * np.sqrt(w[BEFORE * B + i]) / SINGULAR + SLACK_RAD
        lost = swing > CONVERGED_RAD or length > 0.999 * most * most
        back = lost and tilt > w[BEFORE * B + i]
        for r in range(rotary):
            w[(step + r) * B + i] = 0.0 if back else w[(gone + r) * B + i]


@compiled
def _turn_back(w, c, q, linear, rotary_axes, iteration):
    """Correct the rotary coordinates by what turns the tool axis back, or half of it, and `ALONG` by what that moves.

    It counts the whole way from the programmed pose, so that what fades out near a pole stays faded out. What has
    arrived stays where it is. Returns how many coordinates have not.
    """
    rotary = len(rotary_axes)
    inverse = FREE + 3 * (linear + 2 * rotary)
    product = inverse + 3 * rotary
    gone = product + rotary * rotary + 3 * linear
    step = gone + rotary
    late = 0
    if iteration > RESTING:
        return late
    share = 1.0 if iteration < EASING or iteration == RESTING else 0.5
    for r in range(rotary):
        column = rotary_axes[r] * B
        for i in range(B):
            w[(gone + r) * B + i] = (c[column + i] - q[column + i]) * RAD
    for r in range(rotary):
        to, row = step + r, inverse + 3 * r
        for i in range(B):
            w[to * B + i] = (
                w[row * B + i] * w[TILT * B + i]
                + w[(row + 1) * B + i] * w[(TILT + 1) * B + i]
                + w[(row + 2) * B + i] * w[(TILT + 2) * B + i]
            )
        for s in range(rotary):
            weight, other = product + r * rotary + s, gone + s
            for i in range(B):
                w[to * B + i] += w[weight * B + i] * w[other * B + i]
    limited = _limit(w, step, rotary)
    if iteration < RESTING:
        late += limited
    else:
        _come_to_rest(w, step, gone, rotary)
    for r in range(rotary):
        column, to, at = rotary_axes[r] * B, step + r, gone + r
        for i in range(B):
            d = share * (w[to * B + i] - w[at * B + i])
            d = d if abs(d) > CONVERGED_RAD else 0.0
            late += 1 if d != 0.0 else 0
            w[to * B + i] = d
        for i in range(B):
            c[column + i] += w[to * B + i] / RAD
        for k in range(3):
            row = FREE + 3 * (linear + r) + k
            for i in range(B):
                w[(ALONG + k) * B + i] += w[row * B + i] * w[to * B + i]
    return late


@compiled
def _slide_back(w, c, q, linear_axes, rotary, moving):
    """Correct the linear coordinates so that the tip comes to its place; as `_turn_back`."""
    linear = len(linear_axes)
    columns = FREE + 3 * (linear + 2 * rotary) + 3 * rotary + rotary * rotary
    step = columns + 3 * linear + 2 * rotary
    late = 0
    if moving:
        for v in range(linear):
            column = linear_axes[v] * B
            for k in range(3):
                row = columns + 3 * v + k
                for i in range(B):
                    w[(ALONG + k) * B + i] -= w[row * B + i] * (c[column + i] - q[column + i])
    for v in range(linear):
        column, row = linear_axes[v] * B, FREE + 3 * v
        for i in range(B):
            w[step * B + i] = -(
                w[row * B + i] * w[ALONG * B + i]
                + w[(row + 1) * B + i] * w[(ALONG + 1) * B + i]
                + w[(row + 2) * B + i] * w[(ALONG + 2) * B + i]
            )
        if moving:
            for i in range(B):
                w[step * B + i] -= c[column + i] - q[column + i]
        for i in range(B):
            d = w[step * B + i]
            d = d if abs(d) > CONVERGED_MM else 0.0
            late += 1 if d != 0.0 else 0
            w[step * B + i] = d
        for i in range(B):
            c[column + i] += w[step * B + i]
    return late


@compiled
def _step(w, c, q, linear_axes, rotary_axes, moving, iteration):
    """Correct the coordinates: rotary axes turn the tool axis back, linear ones then put the tip in its place."""
    for k in range(3):
        for i in range(B):
            w[(ALONG + k) * B + i] = w[(MISS + k) * B + i]
    late = _turn_back(w, c, q, len(linear_axes), rotary_axes, iteration)
    return late + _slide_back(w, c, q, linear_axes, len(rotary_axes), moving)


@compiled
def solve(
    positions, start, stop, ideal_ops, ideal_constants, real_ops, real_constants, cells, segments, lookup, grid, tool,
    linear_axes, rotary_axes, moving, corrected, residual, tilt, deviation, w, q, c, active, n, e, found,
):  # fmt: skip
    """Compensate positions[start:stop], shape (n, A), into `corrected` (n, A), `residual` (n,) and `tilt` (n,).

    `deviation` (n, 3) is how far off the tip is at the positions themselves.

    Fixed point iteration: the ideal chain says what each axis does, the erroneous chain how far off the tool is. An
    iteration leaves of the error what the terms' slopes are, some 1e-3. The last arguments are room to work in, the
    others are `kernel_plan.Plan`.
    """
    linear, rotary = len(linear_axes), len(rotary_axes)
    count = positions.shape[1]
    for first in range(start, stop, B):
        last = min(first + B, stop)
        for a in range(count):
            for i in range(B):
                q[a * B + i] = c[a * B + i] = positions[min(first + i, last - 1), a]
        _ideal_pass(w, q, ideal_ops, ideal_constants, tool, linear, rotary, active)
        for k in range(3):
            for i in range(B):
                w[(WANTED_TIP + k) * B + i] = w[(TIP + k) * B + i]
                w[(WANTED_AXIS + k) * B + i] = w[(AXIS + k) * B + i]
        if moving:
            _invert_linear(w, linear, rotary, n, e)
        least = 1.0
        if rotary:
            least = _solve_rotary(w, linear, rotary)
        arrived = False
        for iteration in range(MAX_ITERATIONS + 1):
            if 0 < iteration <= FOLLOWING and rotary > 0 and (least < CLOSE * CLOSE or rotary > 2) and not arrived:
                _ideal_pass(w, c, ideal_ops, ideal_constants, tool, linear, rotary, active)
                if moving:
                    _invert_linear(w, linear, rotary, n, e)
                least = _solve_rotary(w, linear, rotary)
            # Without rotary axes nothing acts on the tool's tilt, so it waits for where the tip is nearly there.
            with_axis = rotary > 0 or iteration > 1 or arrived
            _real_pass(w, c, found, real_ops, real_constants, cells, segments, lookup, grid, tool, with_axis)
            _miss(w)
            if iteration == 0:
                for i in range(B):
                    x, y, z = w[TILT * B + i], w[(TILT + 1) * B + i], w[(TILT + 2) * B + i]
                    w[BEFORE * B + i] = x * x + y * y + z * z
                for i in range(last - first):
                    for k in range(3):
                        deviation[first + i, k] = w[(MISS + k) * B + i]
            if (arrived and with_axis) or iteration == MAX_ITERATIONS:
                break
            arrived = _step(w, c, q, linear_axes, rotary_axes, moving, iteration) == 0
            if arrived and with_axis:
                break
        for i in range(last - first):
            for a in range(count):
                corrected[first + i, a] = c[a * B + i]
            x, y, z = w[MISS * B + i], w[(MISS + 1) * B + i], w[(MISS + 2) * B + i]
            residual[first + i] = np.sqrt(x * x + y * y + z * z)
            x, y, z = w[TILT * B + i], w[(TILT + 1) * B + i], w[(TILT + 2) * B + i]
            cosine = 0.0
            for k in range(3):
                cosine += w[(AXIS + k) * B + i] * w[(WANTED_AXIS + k) * B + i]
            tilt[first + i] = np.arctan2(np.sqrt(x * x + y * y + z * z), cosine)


_P, _I = types.voidptr, types.int64
SIGNATURE = types.void(
    _P, _I, _I, _I, _P, _P, _I, _P, _P, _I, _P, _I, _P, _I, _P, _P, _P, _P, _I, _P, _I, _I, _P, _P, _P, _P,
    _P, _P, _P, _P,
)  # fmt: skip


def entry(
    positions, axes, start, stop, ideal_ops, ideal_constants, ideal, real_ops, real_constants, real, cells, cell_count,
    segments, segment_count, lookup, grid, tool, linear_axes, linear, rotary_axes, rotary, moving, corrected, residual,
    tilt, deviation, work, active, matrices, found,
):  # fmt: skip
    """Call `solve` with arrays made of their addresses and lengths: what code without a compiler can be called with."""
    count = rows_of(linear, rotary)
    space = carray(work, ((count + 2 * axes) * B,), dtype=np.float64)
    w, q, c = space[: count * B], space[count * B : (count + axes) * B], space[(count + axes) * B :]
    m = carray(matrices, (2, 3, 3), dtype=np.float64)
    solve(
        carray(positions, (stop, axes), dtype=np.float64), start, stop,
        carray(ideal_ops, (ideal, 4), dtype=np.int64), carray(ideal_constants, (ideal, 12), dtype=np.float64),
        carray(real_ops, (real, 4), dtype=np.int64), carray(real_constants, (real, 12), dtype=np.float64),
        carray(cells, (cell_count,), dtype=np.int32), carray(segments, (segment_count,), dtype=np.float64),
        carray(lookup, (axes, 3), dtype=np.int64), carray(grid, (axes, 3), dtype=np.float64),
        carray(tool, (6,), dtype=np.float64), carray(linear_axes, (linear,), dtype=np.int64),
        carray(rotary_axes, (rotary,), dtype=np.int64), moving != 0,
        carray(corrected, (stop, axes), dtype=np.float64), carray(residual, (stop,), dtype=np.float64),
        carray(tilt, (stop,), dtype=np.float64), carray(deviation, (stop, 3), dtype=np.float64),
        w, q, c, carray(active, (linear + 2 * rotary + 1,), dtype=np.int64), m[0], m[1],
        carray(found, (B,), dtype=np.uint64),
    )  # fmt: skip
