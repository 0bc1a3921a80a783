"""Prometheus metrics: one registry for each app, and the requests that it has answered."""

from __future__ import annotations

import time

from prometheus_client import CollectorRegistry, Gauge, Histogram, ProcessCollector
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.machine_metrics import MachineCollector
from service.store.journal import Journal

BUCKETS_S = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5)
"""From a single position, well below 2 ms, to the largest telemetry request."""
METHODS = frozenset({"GET", "POST", "PUT", "PATCH", "DELETE", "HEAD", "OPTIONS"})
OTHER = "other"
"""Stands for every path without a route of its own, and every method that HTTP does not know: a client can send any
number of them, and each label is kept for good."""


class Metrics:
    """The registry of one app.

    Attributes
    ----------
    registry : what `/metrics` writes out
    machines : what is known of the machines, taken anew for each answer
    """

    def __init__(self) -> None:
        self.registry = CollectorRegistry(auto_describe=True)
        self.machines = MachineCollector()
        self._requests = Histogram(
            "thermotrue_request_seconds",
            "Time from a request to the end of its answer; route 'other' is every unknown path.",
            ["method", "route", "status"],
            buckets=BUCKETS_S,
            registry=self.registry,
        )
        self._children: dict[tuple[str, str, str], Histogram] = {}
        self.registry.register(self.machines)
        ProcessCollector(registry=self.registry)

    def watch(self, journal: Journal) -> None:
        """Tell of the storage as well."""
        ok = Gauge("thermotrue_storage_ok", "1 while the database takes writes.", registry=self.registry)
        ok.set_function(lambda: float(journal.failure is None))
        rows = Gauge("thermotrue_storage_queued_rows", "Rows that are not durable yet.", registry=self.registry)
        rows.set_function(lambda: float(journal.queued_rows))

    def observe(self, scope: Scope, status: str, seconds: float) -> None:
        """Count a request that has been answered."""
        method = scope["method"] if scope["method"] in METHODS else OTHER
        key = method, getattr(scope.get("route"), "path", OTHER), status
        child = self._children.get(key)
        if child is None:
            child = self._children[key] = self._requests.labels(*key)
        child.observe(seconds)


class RequestMetrics:
    """ASGI middleware that times requests, those that fail included."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app, self._metrics = app, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and count it once it is done with."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        status = "none"  # where the client has left before its answer

        async def watched(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = str(message["status"])
            await send(message)

        began_s = time.perf_counter()
        try:
            await self._app(scope, receive, watched)
        finally:
            self._metrics.observe(scope, status, time.perf_counter() - began_s)
