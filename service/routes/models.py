"""`/v1/machines/{name}/models`: bundles uploaded, activated, rolled back."""

from __future__ import annotations

from http import HTTPStatus
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Request, Response

from service.access.roles import Role, caller_of, needs
from service.machine_state import MachineState
from service.models.schemas import ModelInfo, ModelReply, ModelsReply
from service.models.shelf import Kept, Shelf
from service.problems import Problem
from service.routes.dependencies import NamedMachine
from service.timestamps import format_time

router = APIRouter(prefix="/v1", tags=["models"])

ADMIN = [needs(Role.ADMIN)]
MEDIA_TYPES = ("application/zip", "application/x-zip-compressed", "application/octet-stream")
UPLOAD: dict[str, Any] = {
    "requestBody": {
        "description": "A ZIP archive of the bundle's files, without folders.",
        "required": True,
        "content": {"application/zip": {"schema": {"type": "string", "format": "binary"}}},
    }
}


async def _shelf(request: Request) -> Shelf:
    shelf: Shelf = request.app.state.shelf
    return shelf


TheShelf = Annotated[Shelf, Depends(_shelf)]
Version = Annotated[str, Path(description="As listed.", min_length=1, max_length=64)]


@router.get("/machines/{name}/models")
async def list_models(machine: NamedMachine, shelf: TheShelf) -> ModelsReply:
    """List a machine's models, newest first, with what is known of their training and their test."""
    return ModelsReply(machine=machine.machine.name, models=[_info(k) for k in await shelf.models(machine)])


@router.post("/machines/{name}/models", status_code=HTTPStatus.CREATED, dependencies=ADMIN, openapi_extra=UPLOAD)
async def upload_model(machine: NamedMachine, shelf: TheShelf, request: Request, activate: bool = False) -> ModelReply:
    """Upload a bundle; `?activate=true` serves it at once.

    It is verified before it is kept: checksums, contents, that it is of this machine, and that its network computes
    here what it computed when it was exported. A broken one changes nothing. The same bundle again is no error. The
    reply comes once it is durable.
    """
    kind = request.headers.get("content-type", "none").split(";")[0].strip().lower()
    if kind not in MEDIA_TYPES:
        detail = f"the content type must be application/zip, got {kind[:64]}; send the bundle's files as a ZIP archive"
        raise Problem(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "unsupported-media-type", detail)
    who = caller_of(request).name
    row, _ = await shelf.upload(machine, await request.body(), who)
    warnings = await shelf.activate(machine, row.version, who) if activate else []
    return await _reply(machine, shelf, row.version, warnings)


@router.post("/machines/{name}/models/rollback", dependencies=ADMIN)
async def roll_back_model(machine: NamedMachine, shelf: TheShelf, request: Request) -> ModelReply:
    """Activate the model that was active before the present one."""
    version, warnings = await shelf.roll_back(machine, caller_of(request).name)
    return await _reply(machine, shelf, version, warnings)


@router.post("/machines/{name}/models/{version}/activate", dependencies=ADMIN)
async def activate_model(machine: NamedMachine, shelf: TheShelf, request: Request, version: Version) -> ModelReply:
    """Serve the machine with this model from now on.

    Its thermal state is rebuilt from stored telemetry while the present model goes on serving; then it takes over in
    one step, and the correction moves to the new prediction no faster than its rate limit.
    """
    warnings = await shelf.activate(machine, version, caller_of(request).name)
    return await _reply(machine, shelf, version, warnings)


@router.delete("/machines/{name}/models/{version}", status_code=HTTPStatus.NO_CONTENT, dependencies=ADMIN)
async def delete_model(machine: NamedMachine, shelf: TheShelf, request: Request, version: Version) -> Response:
    """Delete a model that is not active."""
    await shelf.remove(machine, version, caller_of(request).name)
    return Response(status_code=HTTPStatus.NO_CONTENT)


async def _reply(machine: MachineState, shelf: Shelf, version: str, warnings: list[str]) -> ModelReply:
    kept = next(k for k in await shelf.models(machine) if k.row.version == version)
    return ModelReply(machine=machine.machine.name, model=_info(kept), warnings=warnings)


def _info(kept: Kept) -> ModelInfo:
    row, summary = kept.row, kept.summary
    return ModelInfo(
        version=row.version,
        origin=row.origin,
        added=format_time(row.added_s),
        added_by=row.added_by,
        active=kept.active,
        activated=None if row.activated_s is None else format_time(row.activated_s),
        kept=summary is not None,
        training={} if summary is None else summary["training"],
        test={} if summary is None else summary["test"],
    )
