"""Clocks that are wrong, and are set right: old telemetry is never taken for new."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from service_client import NOON, TINY, Service, assert_problem, correction_um, sample

from model.bundle import load_bundle
from service.app import create_app
from service.settings import Settings


class Clocks:
    """The service's clock, which somebody may set, and the steady one."""

    def __init__(self) -> None:
        self.clock, self.steady = [NOON], [1000.0]

    def wait(self, seconds: float) -> None:
        self.clock[0] += seconds
        self.steady[0] += seconds


@contextmanager
def running(clocks: Clocks, database: str = "sqlite://") -> Iterator[Service]:
    settings = Settings(database=database)
    app = create_app([load_bundle(TINY)], settings, clock=lambda: clocks.clock[0], steady=lambda: clocks.steady[0])
    with TestClient(app) as client:
        yield Service(client, clocks.clock)


def age_s(service: Service) -> float:
    lines = service.client.get("/metrics").text.splitlines()
    [line] = [one for one in lines if one.startswith("thermotrue_telemetry_age_seconds{")]
    return float(line.split()[1])


def geometric_um(clocks: Clocks) -> Any:
    with running(clocks) as fresh:
        return correction_um(fresh.compensate())


@pytest.mark.parametrize("back_s", [7200.0, 90.0 * 86400.0])
def test_a_clock_set_back_is_told_and_the_thermal_part_fades(back_s: float) -> None:
    clocks = Clocks()
    geometric = geometric_um(clocks)
    with running(clocks) as service:
        service.warm(30.0)
        warm = correction_um(service.compensate())
        assert np.abs(warm - geometric).max() > 10.0
        clocks.clock[0] -= back_s
        seen = []
        for minute in range(46):
            told = service.telemetry(sample(clocks.clock[0], 30.0))
            reply = service.compensate()
            assert (told["ignored"], reply["status"]) == (1, "stale")
            assert "a clock was set back" in reply["warnings"][0]
            assert age_s(service) == pytest.approx(60.0 * minute)
            seen.append(reply["reliability"])
            clocks.wait(60.0)
        assert seen[:10] == [1.0] * 10
        assert (np.diff(seen) <= 0.0).all()
        assert seen[-1] == 0.0
        np.testing.assert_allclose(correction_um(service.compensate()), geometric, atol=0.001)


def test_once_the_clock_has_caught_up_telemetry_counts_again() -> None:
    clocks = Clocks()
    with running(clocks) as service:
        service.warm(30.0)
        clocks.clock[0] -= 3600.0
        clocks.wait(3600.0 + 1.0)
        assert service.compensate()["reliability"] == 0.0  # an hour old, whatever the clock says
        service.telemetry(sample(clocks.clock[0], 30.0))
        reply = service.compensate()
        assert (reply["status"], reply["reliability"]) == ("ok", 1.0)


def test_after_a_restart_with_a_clock_set_back_the_thermal_part_does_not_count(tmp_path: Path) -> None:
    clocks = Clocks()
    geometric = geometric_um(clocks)
    url = f"sqlite:///{tmp_path / 't.db'}"
    with running(clocks, url) as service:
        service.warm(30.0)
        service.compensate()
    clocks.clock[0] -= 86400.0
    with running(clocks, url) as service:
        reply = service.compensate()
        assert (reply["status"], reply["reliability"]) == ("stale", 0.0)
        clocks.wait(600.0)
        np.testing.assert_allclose(correction_um(service.compensate()), geometric, atol=0.001)


def test_a_sender_whose_clock_is_a_little_ahead_is_not_stale() -> None:
    clocks = Clocks()
    with running(clocks) as service:
        service.warm(30.0, end=NOON + 59.0)
        reply = service.compensate()
        assert (reply["status"], reply["reliability"]) == ("ok", 1.0)


def test_milliseconds_in_a_query_are_told_as_those_in_a_body() -> None:
    with running(Clocks()) as service:
        for query in ("1.8e12", "-1", "nan"):
            answer = service.client.get("/v1/machines/tiny/map", params={"time": query})
            detail = "key 'time' in the query: must lie between the years 1970 and 9999; give seconds, got"
            assert_problem(answer, 422, "invalid-request", detail)
        for query in (str(NOON), "2027-01-15T08:00:00Z"):
            assert service.client.get("/v1/machines/tiny/map", params={"time": query}).status_code == 200
