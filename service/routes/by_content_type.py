"""A route whose bodies are read by what they are: JSON the framework's way, others by functions of their own."""

from __future__ import annotations

from collections.abc import Mapping

from fastapi import Request
from fastapi.routing import APIRoute
from starlette.types import ASGIApp, Receive, Scope, Send

from service.content_type import content_type


def route(others: Mapping[bytes, ASGIApp]) -> type[APIRoute]:
    """Return the class of a route.

    Parameters
    ----------
    others : by content type, what answers a request whose body is not JSON, and reads it itself
    """

    class Route(APIRoute):
        async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
            other = others.get(content_type(scope)) if scope["method"] == "POST" else None
            if other is None:
                await super().handle(scope, receive, send)
                return
            for dependency in self.dependencies:  # who may call it: what the framework would ask first
                if dependency.dependency is not None:
                    await dependency.dependency(Request(scope))
            await other(scope, receive, send)

    return Route
