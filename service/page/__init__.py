"""The page at `/`: what the machines do now, for whoever stands beside one. It loads nothing from elsewhere."""

from __future__ import annotations

from functools import partial
from importlib.resources import files

from fastapi import FastAPI
from starlette.responses import Response

FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
}
PAGE = frozenset(FILES)
"""Its paths."""


def install(app: FastAPI) -> None:
    """Serve the page and its files."""
    for path, (name, kind) in FILES.items():
        content = files(__name__).joinpath(name).read_bytes()
        app.add_api_route(path, partial(_file, content, kind), methods=["GET"], include_in_schema=False)


async def _file(content: bytes, kind: str) -> Response:
    return Response(content, media_type=kind)
