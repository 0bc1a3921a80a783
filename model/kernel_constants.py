"""Numbers that the compiled path and what prepares its arguments share.

The source and its compiler are needed once for a version and a processor; these are needed always.
"""

LANES = 64
SHIFT, AFFINE, SLIDE, TURN, ERROR, ERROR_BACK, PLACE = range(7)
"""Operations: add a constant; a constant rigid motion; slide along an axis; turn about one; an axis' motion errors, and
their inverse; nothing but what begins there."""
NOTHING, LINEAR, ROTARY = range(3)
"""What an operation begins in the ideal pass: a vector of a linear axis, those of a rotary one."""

TIP, AXIS, VALUES, SINES, WANTED_TIP, WANTED_AXIS, MISS, TILT, ALONG, BEFORE = 0, 3, 6, 12, 18, 21, 24, 27, 30, 33
FREE = 34
"""Rows of the workspace: three of the tip, three of the tool axis, six error terms, sine and cosine of three angles,
what is wanted, what is missing, where the linear axes have to bring the tip, how far the tool axis was tilted before
(squared); from `FREE` on vectors by axis."""
ROW = 16
"""Numbers per segment of a table: start, six values there, six slopes, three unused that round it to cache lines."""

SINGULAR = 0.02
"""How far the tool axis turns per angle of the rotary axes, below which a pose counts as near singular. About a degree
beside the pole of a rotary table, there an orientation error of 1 mrad asks for 3 degrees of table; nearer, the
correction fades to none instead of growing without bound."""
CLOSE = 5.0 * SINGULAR
"""Below it the axes' effect is worked out anew where they went to, and not only where they were programmed; with three
rotary axes always, as it then also says how they share the turn."""
SLACK_RAD = 0.05
"""Rotary axes turn together by no more than twice the tilt before over `SINGULAR`, plus this: terms may grow on the
way."""
CONVERGED_MM, CONVERGED_RAD = 1e-8, 1e-11
"""Where iteration stops: a hundredth of what is promised."""
FOLLOWING, EASING, RESTING, MAX_ITERATIONS = 3, 20, 40, 80
"""Up to which iteration the axes' effect is followed; from which the rotary axes go half the way; from which they
rest, so that the linear ones can finish: near a pole, where the correction fades, a knot of an error table can keep
them swinging between its two sides for ever. Where they find no place and the tool is tilted more than before, they go
back to where they were programmed: as where a head with a slanted axis reaches no further, and a large turn tilts the
tool more than the error does."""


def rows(linear: int, rotary: int) -> int:
    """Return how many rows the workspace has for so many free axes."""
    return FREE + 3 * (linear + 2 * rotary) + 3 * rotary + rotary * rotary + 3 * linear + 2 * rotary + 1
