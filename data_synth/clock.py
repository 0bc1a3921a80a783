"""When a run happens: hour of the week and day of the year, for shifts, weekends, days and seasons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_synth.network import Array

DAY_H = 24.0
WEEK_H = 7 * DAY_H
YEAR_DAYS = 365.0

Window = tuple[float, float]


@dataclass(frozen=True)
class Clock:
    """A moment: hours since Monday, midnight, and days since 1 January, midnight.

    The two are drawn apart (a year may begin on any day of the week) but agree on the hour of the day.
    """

    hour_of_week: float
    day_of_year: float

    @classmethod
    def draw(cls, hours: Sequence[Window], days: Window, rng: np.random.Generator) -> Clock:
        """Return a moment within one of these windows of the week [h], on one of these days of the year."""
        window = hours[int(rng.integers(len(hours)))]
        hour = float(rng.uniform(*window)) % WEEK_H
        day = float(np.floor(rng.uniform(*days)))
        return cls(hour, (day + hour % DAY_H / DAY_H) % YEAR_DAYS)

    def later(self, hours: float) -> Clock:
        """Return the moment so many hours later; a negative number gives an earlier one."""
        return Clock((self.hour_of_week + hours) % WEEK_H, (self.day_of_year + hours / DAY_H) % YEAR_DAYS)

    def hours(self, n: int, period_s: float) -> Array:
        """Return the hour of the week at the start of n intervals from here, shape (n,), growing past a week's end."""
        hours: Array = self.hour_of_week + np.arange(n, dtype=np.float64) * (period_s / 3600.0)
        return hours

    def days(self, n: int, period_s: float) -> Array:
        """Return the day of the year likewise, shape (n,)."""
        days: Array = self.day_of_year + np.arange(n, dtype=np.float64) * (period_s / 3600.0 / DAY_H)
        return days


MONDAY_MORNING = Clock(6.0, 90.25)
