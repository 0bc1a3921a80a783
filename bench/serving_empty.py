"""A FastAPI route with the service's own request and response records, and nothing in between.

It runs as the service does: the same server with the same settings.
"""

import sys

from fastapi import FastAPI

from service.listen import run, take_port
from service.schemas import CompensateReply, CompensateRequest, Point, Vector
from service.settings import Settings
from service.status import Status

app = FastAPI()
ZERO = {"X": 0.0, "Y": 0.0, "Z": 0.0}
POINT = Point(corrected=ZERO, correction=ZERO, deviation_um=Vector(x=0.0, y=0.0, z=0.0), limited=False)
REPLY = CompensateReply(
    machine="empty",
    time="2027-01-15T08:00:00Z",
    model="0",
    status=Status.OK,
    reliability=1.0,
    warnings=[],
    points=[POINT],
)


@app.post("/v1/machines/{name}/compensate", response_model_exclude_none=True)
async def answer(name: str, request: CompensateRequest) -> CompensateReply:
    """Answer the same to everything."""
    return REPLY


@app.get("/readyz")
async def ready() -> dict[str, str]:
    """Answer that it is ready."""
    return {"status": "ready"}


if __name__ == "__main__":
    settings = Settings(port=int(sys.argv[sys.argv.index("--port") + 1]))
    with take_port(settings) as listener:
        run(app, listener, settings, ready=lambda: None)
