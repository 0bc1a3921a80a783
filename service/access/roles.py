"""Roles: what a caller may do, and how a route says which one it needs."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from enum import StrEnum
from http import HTTPStatus
from typing import Any

from fastapi import Depends, Request
from starlette.requests import HTTPConnection

from service.problems import Problem


class Role(StrEnum):
    """What a key is for; each includes the ones before it."""

    VIEWER = "viewer"
    """Reads: machines, errors, metrics, the documentation."""
    GATEWAY = "gateway"
    """Stands beside a machine: telemetry, corrections, the map, the datum, measurements."""
    ADMIN = "admin"
    """Changes what corrects: models."""

    def includes(self, other: Role) -> bool:
        """Return whether this role may do all that the other one may."""
        return _RANK[self] >= _RANK[other]


_RANK = {role: rank for rank, role in enumerate(Role)}


@dataclass(frozen=True)
class Caller:
    """Who calls.

    Attributes
    ----------
    name : the key's name, for the audit trail; 'anyone' where keys are off
    key_id : the key's public part; None where keys are off
    """

    name: str
    role: Role
    key_id: str | None = None


ANYONE = Caller("anyone", Role.ADMIN)
"""Every caller where keys are off."""
PASSER_BY = Caller("anyone", Role.VIEWER)
"""Every caller of what is open to all."""


@dataclass(frozen=True)
class Needs:
    """A route's dependency: refuses callers without the role."""

    role: Role

    async def __call__(self, request: Request) -> None:
        """Raise a problem where the caller's role does not do."""
        check_role(request, self.role)


def needs(role: Role) -> Any:
    """Return the dependency of a route that needs this role: `dependencies=[needs(Role.GATEWAY)]`."""
    check: Callable[[Request], Awaitable[None]] = Needs(role)
    return Depends(check)


def caller_of(connection: HTTPConnection) -> Caller:
    """Return who calls; the gate has put it there, for WebSockets, too."""
    caller = connection.scope["state"]["caller"]
    assert isinstance(caller, Caller)
    return caller


def check_role(connection: HTTPConnection, role: Role) -> None:
    """Refuse a caller without the role; a WebSocket's before it is accepted.

    Raises
    ------
    Problem
        403 that names the role needed.
    """
    caller = caller_of(connection)
    if not caller.role.includes(role):
        raise Problem(
            HTTPStatus.FORBIDDEN,
            "wrong-role",
            f"this call needs a key with the role '{role}', got '{caller.name}' with the role '{caller.role}'; "
            f"use another key, or make one: thermotrue keys create NAME --role {role}",
        )
