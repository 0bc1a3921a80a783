"""Pages of other sites, which a browser on this computer may show: they must not steer a service without keys.

A browser sends a form to any address, loopback included, and says in `Origin` which site's page made it. A site can
also give its own name this computer's address (DNS rebinding); so a page counts as the service's own only under an
address or `localhost`.
"""

from __future__ import annotations

import ipaddress
from urllib.parse import urlsplit

from starlette.types import Scope


def foreign_origin(scope: Scope) -> str | None:
    """Return the site whose page made the request, where it is not the service's own; None where none says so."""
    headers: dict[bytes, bytes] = dict(scope["headers"])
    origin = headers.get(b"origin")
    if origin is None:
        return None
    site = origin.decode("latin-1")
    try:
        parts = urlsplit(site)
        host = parts.hostname or ""
    except ValueError:
        return site
    own = parts.netloc == headers.get(b"host", b"").decode("latin-1")
    return None if own and _is_fixed(host) else site


def _is_fixed(host: str) -> bool:
    """Return whether nobody else can point that name somewhere."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return host == "localhost"
    return True
