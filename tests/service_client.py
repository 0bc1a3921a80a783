"""A service in the test's own process, with a clock that the test sets."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from fastapi.testclient import TestClient

from model.bundle import Bundle, load_bundle
from service.app import create_app
from service.machine_state import MachineState
from service.settings import Settings

TINY = Path(__file__).parent / "data" / "tiny_bundle"
NOON = 1.8e9
"""When tests begin, epoch seconds."""
MIDDLE = {"X": 400.0, "Y": 250.0, "Z": 250.0}
TINY_URL = "/v1/machines/tiny"


class Service:
    """A client, the clock, and the state behind them."""

    def __init__(self, client: TestClient, clock: list[float]) -> None:
        self.client, self.clock = client, clock

    @property
    def state(self) -> MachineState:
        machines: dict[str, MachineState] = self.client.app.state.machines  # type: ignore[attr-defined]
        return next(iter(machines.values()))

    def compensate(self, positions: list[dict[str, float]] | None = None, **more: Any) -> dict[str, Any]:
        return self.post("compensate", {"positions": positions or [MIDDLE], **more})

    def telemetry(self, *samples: dict[str, Any]) -> dict[str, Any]:
        return self.post("telemetry", {"samples": samples})

    def post(self, what: str, body: Any = None) -> dict[str, Any]:
        answer = self.client.post(f"{TINY_URL}/{what}", json=body)
        assert answer.status_code == 200, answer.text
        reply: dict[str, Any] = answer.json()
        return reply

    def get(self, what: str = "", **query: Any) -> dict[str, Any]:
        answer = self.client.get(f"{TINY_URL}{what}", params=query)
        assert answer.status_code == 200, answer.text
        reply: dict[str, Any] = answer.json()
        return reply

    def warm(self, degC: float = 30.0, hours: int = 10, end: float | None = None) -> None:
        """Keep all sensors at one temperature for so long that the thermal state has settled."""
        end = self.clock[0] if end is None else end
        self.telemetry(*(sample(end - 3600.0 * h, degC) for h in range(hours, -1, -1)))


@contextmanager
def serving(bundle: Bundle | None = None, **settings: Any) -> Iterator[Service]:
    clock = [NOON]
    app = create_app(
        [bundle or load_bundle(TINY)],
        Settings(**{"database": "sqlite://"} | settings),
        clock=lambda: clock[0],
        steady=lambda: clock[0],
    )
    with TestClient(app, raise_server_exceptions=False) as client:
        yield Service(client, clock)


def sample(time: float, degC: float = 20.0, rpm: float = 0.0, **temperatures: float | None) -> dict[str, Any]:
    readings = {"spindle": degC, "column": degC, "ambient": degC} | temperatures
    return {"time": time, "temperatures": readings, "channels": {"spindle_rpm": rpm}}


def correction_um(reply: dict[str, Any]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Corrections of all points, shape (n, 3)."""
    return 1000.0 * np.array([[p["correction"][a] for a in "XYZ"] for p in reply["points"]])


def assert_problem(answer: Any, status: int, kind: str, detail: str = "") -> None:
    """Check an error's body; `detail` is how its sentence starts."""
    assert answer.headers["content-type"] == "application/problem+json"
    body = answer.json()
    assert set(body) == {"type", "title", "status", "detail", "instance", "request_id"}
    assert body["request_id"] == answer.headers["x-request-id"]
    assert (answer.status_code, body["status"]) == (status, status)
    assert body["type"] == f"urn:thermotrue:problem:{kind}"
    assert body["title"]
    assert body["instance"] == answer.request.url.path
    assert body["detail"].startswith(detail), body["detail"]
    assert "\n" not in body["detail"]
    assert not body["detail"].endswith(".")
