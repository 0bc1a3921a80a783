"""What a request's body says that it is."""

from __future__ import annotations

from starlette.types import Scope

ARROW = b"application/vnd.apache.arrow.stream"
JSON = b"application/json"


def content_type(scope: Scope) -> bytes:
    """Return the content type in lower case and without parameters, empty where none was sent."""
    for key, value in scope["headers"]:
        if key == b"content-type":
            return bytes(value) if value == JSON else bytes(value.partition(b";")[0].strip().lower())
    return b""
