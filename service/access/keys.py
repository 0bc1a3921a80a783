"""Keys: `tt_<id>_<secret>`. The id finds the record, the secret proves that the caller holds the key.

A secret is 256 random bits, so nobody finds it by trying, and its SHA-256 is enough to keep it unreadable in the
database. A slow hash protects what people choose, and would cost every request a tenth of a second.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from dataclasses import dataclass
from functools import cached_property

from service.access.roles import Caller, Role

KEY = re.compile(r"tt_([0-9a-f]{12})_([0-9a-f]{64})")
"""Hexadecimal, so that a double click marks all of it; the prefix lets scanners find keys that got into a file."""


@dataclass(frozen=True)
class Record:
    """What is kept of a key.

    Attributes
    ----------
    id : the key's public part
    hash : SHA-256 of the secret part, hexadecimal
    created_s, revoked_s : epoch seconds
    """

    id: str
    name: str
    role: Role
    hash: str
    created_s: float
    revoked_s: float | None = None

    @cached_property
    def caller(self) -> Caller:
        """The key's holder, as requests carry it."""
        return Caller(self.name, self.role, self.id)


_NOBODY = Record("", "", Role.VIEWER, "0" * 64, 0.0, revoked_s=0.0)
"""Compared with where the id is unknown, so that an unknown id takes as long as a wrong secret."""


def new_key(name: str, role: Role, now_s: float) -> tuple[str, Record]:
    """Return a new key and its record; the key itself is kept nowhere."""
    public, secret = secrets.token_hex(6), secrets.token_hex(32)
    return f"tt_{public}_{secret}", Record(public, name, role, digest(secret), now_s)


def digest(secret: str) -> str:
    """Return what is kept of a secret."""
    return hashlib.sha256(secret.encode()).hexdigest()


def holder(key: str, records: dict[str, Record]) -> Caller | None:
    """Return whose key that is; None where nobody's, or where it was revoked.

    Parameters
    ----------
    records : by their ids
    """
    found = KEY.fullmatch(key)
    if found is None:
        return None
    public, secret = found.groups()
    record = records.get(public, _NOBODY)
    same = hmac.compare_digest(digest(secret), record.hash)
    return record.caller if same and record.revoked_s is None else None


def without_keys(text: str) -> str:
    """Return a text with the secret parts of all keys in it left out, for logs."""
    return KEY.sub(r"tt_\1_(secret)", text)
