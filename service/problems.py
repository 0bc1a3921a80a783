"""Errors on the wire: RFC 9457 problem details for every one of them, the framework's own included."""

from __future__ import annotations

import json
import logging
import reprlib
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any, cast, get_type_hints
from urllib.parse import quote

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.routing import iter_route_contexts
from pydantic import BaseModel, ConfigDict, Field
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import compile_path
from starlette.types import ExceptionHandler, Receive, Scope, Send
from starlette.websockets import WebSocket

from model.exceptions import ComputeError, InputError, ThermotrueError
from model.validation import sentence
from service.request_id import HEADER, current

log = logging.getLogger(__name__)

MEDIA_TYPE = "application/problem+json"
MAX_DETAIL = 600
"""Longest detail; what a client sent is quoted in it, and may be long."""


class ProblemDetails(BaseModel):
    """An error, RFC 9457."""

    type: str = Field(description="Names the kind of problem: urn:thermotrue:problem:<kind>.")
    title: str
    status: int
    detail: str = Field(description="What must hold, what came, where, what to do.")
    instance: str = Field(description="The path that was asked for.")
    request_id: str = Field(description="As in the header X-Request-ID, and in the service's log.")

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "type": "urn:thermotrue:problem:invalid-request",
                    "title": "Unprocessable Entity",
                    "status": 422,
                    "detail": "axis 'X' must lie within 0 and 800 mm, got 800.5 in positions[1]",
                    "instance": "/v1/machines/vmc3/compensate",
                    "request_id": "3f2a7c1e9b5d4c60a1f8e2d7b6c59403",
                }
            ]
        }
    )


RESPONSES: dict[int | str, dict[str, Any]] = {
    "default": {
        "description": "Any error, as RFC 9457 problem details.",
        "headers": {HEADER: {"description": "The request's id.", "schema": {"type": "string"}}},
        "content": {MEDIA_TYPE: {"schema": {"$ref": f"#/components/schemas/{ProblemDetails.__name__}"}}},
    }
}
"""What every route may answer besides its own reply."""


class Problem(ThermotrueError):
    """An error that a request ends with.

    Parameters
    ----------
    status : of HTTP
    kind : last part of the problem's type
    detail : one sentence, as the messages of all exceptions here
    headers : to send along
    """

    def __init__(self, status: HTTPStatus, kind: str, detail: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(detail)
        self.status, self.kind, self.headers = status, kind, headers


def unprocessable(detail: str) -> Problem:
    """Return the problem of a request that is well formed and asks for what cannot be."""
    return Problem(HTTPStatus.UNPROCESSABLE_ENTITY, "invalid-request", detail)


def install(app: FastAPI) -> None:
    """Make every error of the app a problem."""
    app.add_exception_handler(Problem, cast("ExceptionHandler", _on_problem))
    app.add_exception_handler(InputError, _on_input_error)
    app.add_exception_handler(RequestValidationError, _on_validation)
    app.add_exception_handler(HTTPException, _on_http_exception)
    app.add_exception_handler(ComputeError, _on_compute_error)
    app.add_exception_handler(Exception, _on_anything)


async def _on_problem(request: Request | WebSocket, problem: Exception) -> Response | None:
    assert isinstance(problem, Problem)
    answer = _answer(request.url.path, problem.status, problem.kind, str(problem), problem.headers)
    if isinstance(request, WebSocket):
        await request.send_denial_response(answer)  # where it has been accepted, its route answers its problems
        return None
    return answer


async def _on_input_error(request: Request, problem: Exception) -> Response:
    return _respond(request, HTTPStatus.UNPROCESSABLE_ENTITY, "invalid-request", str(problem))


async def _on_compute_error(request: Request, problem: Exception) -> Response:
    log.error("computation failed", extra={"reason": str(problem), "path": request.url.path})
    return _respond(request, HTTPStatus.INTERNAL_SERVER_ERROR, "computation-failed", str(problem))


async def _on_anything(request: Request, problem: Exception) -> Response:
    # The traceback is logged by the server, which sees the exception, too.
    detail = "the service must answer every request, and failed on this one; its log has the traceback"
    return _respond(request, HTTPStatus.INTERNAL_SERVER_ERROR, "internal", detail)


async def _on_http_exception(request: Request, problem: Exception) -> Response:
    assert isinstance(problem, HTTPException)
    status = HTTPStatus(problem.status_code)
    path, method = request.url.path, request.method
    kind, detail = status.phrase.lower().replace(" ", "-"), str(problem.detail)
    if status == HTTPStatus.NOT_FOUND:
        detail = f"there is nothing at '{path}'; /docs lists what there is"
    elif status == HTTPStatus.METHOD_NOT_ALLOWED:
        # The framework names the methods of the first route with that path alone.
        allowed = ", ".join(sorted(_methods(request)))
        detail = f"'{path}' must be called with {allowed.replace(', ', ' or ')}, got {method}"
        return _respond(request, status, kind, detail, {"Allow": allowed})
    elif status == HTTPStatus.BAD_REQUEST:
        kind, detail = "malformed-body", "the body must be JSON in UTF-8, and could not be read as such"
    return _respond(request, status, kind, detail, problem.headers)


def _methods(request: Request) -> set[str]:
    """Return the methods of all routes that have the request's path, the most literal one where several have."""
    methods: dict[str, set[str]] = {}
    for route in iter_route_contexts(request.app.routes):
        if route.path and route.methods and compile_path(route.path)[0].match(request.url.path):
            methods.setdefault(route.path, set()).update(route.methods)
    return methods[min(methods, key=lambda path: path.count("{"))] if methods else set()


async def _on_validation(request: Request, problem: Exception) -> Response:
    assert isinstance(problem, RequestValidationError)
    first = problem.errors()[0]
    place = str(first["loc"][0])
    if first["type"] == "json_invalid":
        reason = first.get("ctx", {}).get("error", "it is not")
        at = first["loc"][-1]
        detail = f"the body must be JSON, got text that is not: {reason} at character {at}"
        return _respond(request, HTTPStatus.BAD_REQUEST, "malformed-body", detail)
    if place == "body" and len(first["loc"]) == 1:
        kind = request.headers.get("content-type", "none")
        if first["type"] != "missing" and "json" not in kind:
            detail = f"the content type must be application/json, got {kind}; send that header"
            return _respond(request, HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "unsupported-media-type", detail)
        came = "none" if first["type"] == "missing" else _SHORT.repr(first["input"])
        detail = f"the body must be a JSON object, got {came}; /docs shows one"
        return _respond(request, HTTPStatus.UNPROCESSABLE_ENTITY, "invalid-request", detail)
    # As pydantic's own findings: without the place they start with, and with short inputs.
    findings = [
        {**e, "loc": e["loc"][1:], "input": _Brief(e.get("input"))} for e in problem.errors() if e["loc"][0] == place
    ]
    detail = sentence(findings, _schema(request, place), f"the {place}")
    return _respond(request, HTTPStatus.UNPROCESSABLE_ENTITY, "invalid-request", detail)


_SHORT = reprlib.Repr()
_SHORT.maxlevel = _SHORT.maxlist = _SHORT.maxdict = 2
_SHORT.maxstring = 60


class _Brief:
    def __init__(self, value: Any) -> None:
        self._value = value

    def __repr__(self) -> str:
        return _SHORT.repr(self._value)


def _schema(request: Request, place: str) -> type[BaseModel]:
    """Return the record that the route reads from the body or the query, for the names that it knows."""
    hints = get_type_hints(request.scope["endpoint"])
    records = [h for h in hints.values() if isinstance(h, type) and issubclass(h, BaseModel)]
    wanted = [h for h in records if h.__name__.endswith("Query" if place == "query" else "Request")]
    return wanted[0] if wanted else BaseModel


def _respond(
    request: Request, status: HTTPStatus, kind: str, detail: str, headers: Mapping[str, str] | None = None
) -> Response:
    return _answer(request.url.path, status, kind, detail, headers)


async def refuse(problem: Problem, scope: Scope, receive: Receive, send: Send) -> None:
    """Answer with a problem from within a middleware; a WebSocket is not accepted then."""
    answer = _answer(scope["path"], problem.status, problem.kind, str(problem), problem.headers)
    if scope["type"] == "websocket":
        await WebSocket(scope, receive, send).send_denial_response(answer)
    else:
        await answer(scope, receive, send)


def details(path: str, problem: Exception) -> dict[str, Any]:
    """Return what `ProblemDetails` describes, of any exception: where there is no response to put it into."""
    if isinstance(problem, Problem):
        return _details(path, problem.status, problem.kind, str(problem))
    if isinstance(problem, InputError):
        return _details(path, HTTPStatus.UNPROCESSABLE_ENTITY, "invalid-request", str(problem))
    if isinstance(problem, ComputeError):
        return _details(path, HTTPStatus.INTERNAL_SERVER_ERROR, "computation-failed", str(problem))
    detail = "the service must answer every request, and failed on this one; its log has the traceback"
    return _details(path, HTTPStatus.INTERNAL_SERVER_ERROR, "internal", detail)


def _answer(
    path: str, status: HTTPStatus, kind: str, detail: str, headers: Mapping[str, str] | None = None
) -> Response:
    # ASCII, since a client may have sent half a surrogate pair, which is quoted here and has no UTF-8.
    content = json.dumps(_details(path, status, kind, detail), ensure_ascii=True)
    return Response(content, status, headers=headers, media_type=MEDIA_TYPE)


def _details(path: str, status: HTTPStatus, kind: str, detail: str) -> dict[str, Any]:
    if len(detail) > MAX_DETAIL:
        detail = detail[:MAX_DETAIL] + "…"
    return {
        "type": f"urn:thermotrue:problem:{kind}",
        "title": status.phrase,
        "status": status,
        "detail": detail,
        "instance": quote(path, errors="replace"),
        "request_id": current() or "",
    }
