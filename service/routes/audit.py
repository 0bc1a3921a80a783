"""`/v1/machines/{name}/audit`: what was changed, when and by whom."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import APIRouter, Query, Request

from service.routes.dependencies import NamedMachine
from service.schemas import AuditEntry, AuditQuery, AuditReply
from service.store import audit
from service.store.store import Store
from service.timestamps import format_time

router = APIRouter(prefix="/v1", tags=["machines"])


@router.get("/machines/{name}/audit")
async def show_audit(machine: NamedMachine, http: Request, query: Annotated[AuditQuery, Query()]) -> AuditReply:
    """Show what was changed for a machine or for the whole service, newest first."""
    store: Store = http.app.state.store
    name = machine.machine.name
    found = await asyncio.to_thread(audit.entries, store.engine, name, query.limit)
    entries = [
        AuditEntry(
            time=format_time(e["time_s"]), who=e["who"], action=e["action"], machine=e["machine"], detail=e["detail"]
        )
        for e in found
    ]
    return AuditReply(machine=name, entries=entries)
