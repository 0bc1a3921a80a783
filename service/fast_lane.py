"""The short way for what control loops ask hundreds of times a second: plain JSON to `compensate`.

The framework's way (look for the route, look at each parameter, parse, check, build records, turn them into JSON) takes
several times as long as the correction. So a plain request is checked by the same record in one go, and answered by the
same function. Whatever is not plain, and whatever is wrong with a plain one, goes the framework's way, which words the
problem. Who calls, and how often, has been looked at before either.
"""

from __future__ import annotations

from pydantic import ValidationError
from pydantic_core import to_json
from starlette.exceptions import HTTPException
from starlette.routing import BaseRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from model.exceptions import ThermotrueError
from service.access.roles import Role
from service.content_type import JSON, content_type
from service.machine_state import MachineState
from service.routes.compensate import PLAIN, corrections
from service.schemas import CompensateRequest

BEFORE, AFTER = "/v1/machines/", "/compensate"
_read_json = CompensateRequest.__pydantic_validator__.validate_json


class FastLane:
    """ASGI middleware that answers plain requests to `compensate`.

    Parameters
    ----------
    route : the one that answers all others, for the metrics
    """

    def __init__(self, app: ASGIApp, route: BaseRoute) -> None:
        self._app, self._route = app, route

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer the request, or pass it on as it came."""
        machine = _machine(scope) if scope["type"] == "http" and scope["method"] == "POST" else None
        if machine is None:
            await self._app(scope, receive, send)
            return
        messages: list[Message] = []
        try:
            messages.append(await receive())
            while messages[-1].get("more_body", False):
                messages.append(await receive())
        except HTTPException:  # too long; it comes again where it is answered
            content = None
        else:
            content = _answer(machine, b"".join([message.get("body", b"") for message in messages]))
        if content is None:
            await self._app(scope, _again(messages, receive), send)
            return
        scope["route"] = self._route
        headers = [(b"content-type", JSON), (b"content-length", b"%d" % len(content))]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": content})


def _machine(scope: Scope) -> MachineState | None:
    """Return the machine whose corrections a plain request asks for; None where it is not one."""
    path: str = scope["path"]
    if not (path.startswith(BEFORE) and path.endswith(AFTER)) or scope["query_string"] or content_type(scope) != JSON:
        return None
    if not scope["state"]["caller"].role.includes(Role.GATEWAY):
        return None
    machines: dict[str, MachineState] | None = scope["app"].state.machines
    return None if machines is None else machines.get(path[len(BEFORE) : -len(AFTER)])


def _answer(machine: MachineState, body: bytes) -> bytes | None:
    """Return the reply; None where something is wrong, or a telemetry sample comes along, which is stored first."""
    try:
        request = _read_json(body)
        return None if request.temperatures is not None else to_json(corrections(machine, request, PLAIN))
    except (ValidationError, ThermotrueError):
        return None


def _again(messages: list[Message], receive: Receive) -> Receive:
    """Return what gives those messages once more, and then what comes after them."""
    left = iter(messages)

    async def given() -> Message:
        message = next(left, None)
        return await receive() if message is None else message

    return given
