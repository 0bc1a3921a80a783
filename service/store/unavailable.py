"""What a request gets that must be durable, while the database takes no writes."""

from __future__ import annotations

from http import HTTPStatus

from service.problems import Problem

RETRY_AFTER_S = 5
"""When to try again [s]: a lock or a restart of the database takes about as long (chosen)."""


class StorageUnavailable(Problem):
    """503: the database takes no writes.

    Parameters
    ----------
    reason : the end of a sentence that starts with "the database must take writes"
    consequence : what holds meanwhile, and what to do
    """

    def __init__(
        self, reason: str, consequence: str = "compensation goes on from memory, so send this again later"
    ) -> None:
        self.reason = reason
        headers = {"Retry-After": str(RETRY_AFTER_S)}
        detail = f"the database must take writes, {reason}; {consequence}"
        super().__init__(HTTPStatus.SERVICE_UNAVAILABLE, "storage-unavailable", detail, headers)
