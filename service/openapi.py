"""The OpenAPI description: what the framework makes of the routes, with problems, keys and roles."""

from __future__ import annotations

import copy
from typing import Any

from fastapi import FastAPI
from fastapi.routing import APIRoute, RouteContext, iter_route_contexts

from service.access.gate import OPEN
from service.access.roles import Needs, Role
from service.problems import ProblemDetails

SCHEME = "key"


def described(app: FastAPI, described_plainly: dict[str, Any], *, required: bool) -> dict[str, Any]:
    """Return a description with problems and keys in it.

    Parameters
    ----------
    described_plainly : what the framework makes of the routes
    required : whether callers must show a key; where not, it says that they may
    """
    result = copy.deepcopy(described_plainly)
    components = result.setdefault("components", {})
    components.setdefault("schemas", {})[ProblemDetails.__name__] = ProblemDetails.model_json_schema()
    components["securitySchemes"] = {
        SCHEME: {
            "type": "http",
            "scheme": "bearer",
            "description": "A key made with `thermotrue keys create`, such as tt_3f2a7c1e9b5d_...",
        }
    }
    roles = {(r.path, method.lower()): role_of(r) for r in api_routes(app) for method in r.methods or ()}
    for path, operations in result["paths"].items():
        for method, operation in operations.items():
            if path in OPEN:
                operation["security"] = []
                continue
            operation["security"] = [{SCHEME: []}] if required else [{}, {SCHEME: []}]
            role = roles.get((path, method), Role.VIEWER)
            text = operation.get("description", "")
            operation["description"] = f"{text}\n\nNeeds a key with the role `{role}`." if required else text
    return result


def api_routes(app: FastAPI) -> list[RouteContext]:
    """Return the routes that are functions of ours, those of included routers, too."""
    return [route for route in iter_route_contexts(app.routes) if isinstance(route.original_route, APIRoute)]


def role_of(route: RouteContext) -> Role:
    """Return the role that a route needs; every key is a viewer's at least."""
    found = [d.dependency.role for d in route.dependencies if isinstance(d.dependency, Needs)]
    return found[0] if found else Role.VIEWER
