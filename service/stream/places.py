"""So many at a time, and no more."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus

from service.problems import Problem

MAX_BULK = 2
"""Arrow streams at a time: each takes a core and some 100 MB."""


class Places:
    """Counts what is under way.

    Parameters
    ----------
    most : how many may be at a time
    what : what they are called, such as "streams"
    """

    def __init__(self, most: int, what: str) -> None:
        self._most, self._what = most, what
        self.taken = 0

    @contextmanager
    def place(self) -> Iterator[None]:
        """Take a place for as long as the context lasts.

        Raises
        ------
        Problem
            503 where there is none left.
        """
        if self.taken >= self._most:
            detail = f"at most {self._most} {self._what} can be open at a time, and are; try again in a second"
            raise Problem(HTTPStatus.SERVICE_UNAVAILABLE, "overloaded", detail, {"Retry-After": "1"})
        self.taken += 1
        try:
            yield
        finally:
            self.taken -= 1
