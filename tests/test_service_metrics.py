"""`/metrics`: what Prometheus reads."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse_openmetrics
from prometheus_client.parser import text_string_to_metric_families as parse
from service_client import MIDDLE, NOON, TINY, TINY_URL, Service, correction_um, sample, serving

from model.bundle import load_bundle, write_bundle
from model.compensation import compensate
from model.machine import parse_machine
from service.app import create_app
from service.settings import Settings
from service.status import Status
from service.survey import Survey

SAMPLES = "thermotrue_samples_total"
POSITIONS = "thermotrue_positions_total"


def scrape(client: Any) -> dict[tuple[str, frozenset[tuple[str, str]]], float]:
    answer = client.get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/plain; version=")
    return {(s.name, frozenset(s.labels.items())): s.value for f in parse(answer.text) for s in f.samples}


def value(client: Any, name: str, **labels: str) -> float | None:
    return scrape(client).get((name, frozenset(labels.items())))


def tiny(service: Service, name: str, **labels: str) -> float | None:
    return value(service.client, f"thermotrue_{name}", machine="tiny", **labels)


def requests(client: Any) -> dict[tuple[str, str, str], float]:
    """Counts by method, route and status."""
    found = {}
    for (name, labels), count in scrape(client).items():
        if name == "thermotrue_request_seconds_count":
            by = dict(labels)
            found[by["method"], by["route"], by["status"]] = count
    return found


def test_before_anything_has_come_nothing_is_claimed(service: Service) -> None:
    found = scrape(service.client)
    names = {name for name, _ in found}
    assert (SAMPLES, frozenset({("machine", "tiny"), ("outcome", "accepted")})) in found
    absent = ("sensor_ok", "telemetry_age_seconds", "correction_um", "error_map_age_seconds")
    assert not names & {f"thermotrue_{name}" for name in absent}
    assert tiny(service, "status", status="geometric_only") == 1.0
    assert service.state.served is None  # looking serves nothing


def test_status_is_one_of_its_kinds(service: Service) -> None:
    service.warm(degC=25.0)
    for age_s, expected in ((0.0, Status.OK), (700.0, Status.STALE)):
        service.clock[0] += age_s
        for status in Status:
            assert tiny(service, "status", status=status.value) == float(status == expected)
    assert tiny(service, "reliability") == pytest.approx(1.0 - 100.0 / 1800.0)


def test_sensors_ages_and_counts(service: Service) -> None:
    service.telemetry(sample(NOON - 60.0), sample(NOON - 30.0, column=None), sample(NOON - 90.0))
    service.telemetry(sample(NOON - 40.0))
    service.compensate([MIDDLE] * 7)
    service.clock[0] += 5.0
    assert tiny(service, "telemetry_age_seconds") == 35.0
    assert tiny(service, "error_map_age_seconds") == 5.0
    assert {n: tiny(service, "sensor_ok", sensor=n) for n in ("spindle", "column", "ambient")} == {
        "spindle": 1.0,
        "column": 0.0,
        "ambient": 1.0,
    }
    assert tiny(service, "samples_total", outcome="accepted") == 3.0
    assert tiny(service, "samples_total", outcome="refused") == 1.0
    assert tiny(service, "positions_total") == 7.0


def test_the_correction_is_the_largest_at_the_corners_and_the_middle(service: Service) -> None:
    service.warm(degC=30.0)
    corners = [{"X": x, "Y": y, "Z": z} for x in (0.0, 800.0) for y in (0.0, 500.0) for z in (0.0, 500.0)]
    largest = np.abs(correction_um(service.compensate([*corners, MIDDLE]))).max()
    assert largest > 50.0
    assert tiny(service, "correction_um") == pytest.approx(largest, abs=0.05)
    assert tiny(service, "correction_remaining_um") == 0.0


def test_the_survey_is_the_chains_inverse_to_first_order(service: Service) -> None:
    state = service.state
    survey = Survey.of(state.chain)
    exact = compensate(state.chain, survey.positions, state.bundle.geometry).corrected - survey.positions
    assert survey.largest_um(state.bundle.geometry) == pytest.approx(1000.0 * np.abs(exact).max(), rel=1e-3)


def test_a_correction_beyond_the_limit_is_reported_as_clipped(tmp_path: Path) -> None:
    far = write_bundle(tmp_path / "far", load_bundle(TINY).machine, geometry=[("EX0X", None, 500.0)])
    with serving(far) as service:
        service.compensate()
        assert tiny(service, "correction_um") == 300.0


def test_requests_are_counted_by_route_and_unknown_paths_are_one_label(service: Service) -> None:
    client = service.client
    client.get("/v1/machines")
    for name in ("tiny", "one", "two", "three"):
        client.get(f"/v1/machines/{name}")
    for path in ("/a", "/b", "/v1/machines/tiny/x/y", "/%F0%9F%98%80"):
        client.get(path)
    client.request("BREW", "/a")
    client.request("BREW", TINY_URL)
    client.post(f"{TINY_URL}/compensate", json={})
    client.get(f"{TINY_URL}/compensate")
    service.compensate()
    found = requests(client)
    assert found == {
        ("GET", "/v1/machines", "200"): 1,
        ("GET", "/v1/machines/{name}", "200"): 1,
        ("GET", "/v1/machines/{name}", "404"): 3,
        ("GET", "other", "404"): 4,
        ("other", "other", "404"): 1,
        ("other", "/v1/machines/{name}", "405"): 1,
        ("POST", "/v1/machines/{name}/compensate", "422"): 1,
        ("GET", "/v1/machines/{name}/compensate", "405"): 1,
        ("POST", "/v1/machines/{name}/compensate", "200"): 1,
    }


def test_a_request_that_fails_is_counted_too(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(service.state, "outlook", lambda now_s: 1 / 0)
        assert service.client.get(TINY_URL).status_code == 500
    assert requests(service.client)["GET", "/v1/machines/{name}", "500"] == 1


def test_each_app_has_its_own_registry() -> None:
    with serving() as one, serving() as two:
        one.compensate([MIDDLE] * 3)
        two.telemetry(sample(NOON))
        assert (tiny(one, "positions_total"), tiny(two, "positions_total")) == (3.0, 0.0)
        assert ("POST", "/v1/machines/{name}/compensate", "200") not in requests(two.client)
        assert (tiny(one, "telemetry_age_seconds"), tiny(two, "telemetry_age_seconds")) == (None, 0.0)


@contextmanager
def several(tmp_path: Path) -> Iterator[TestClient]:
    source = load_bundle(TINY).machine.source
    bundles = [
        write_bundle(tmp_path / name, parse_machine(source.replace('name = "tiny"', f'name = "{name}"')))
        for name in ("one", "two")
    ]
    with TestClient(create_app(bundles, Settings())) as client:
        yield client


def test_machines_stand_side_by_side(tmp_path: Path) -> None:
    with several(tmp_path) as client:
        client.post("/v1/machines/two/compensate", json={"positions": [MIDDLE]})
        found = scrape(client)
    assert {n: found[POSITIONS, frozenset({("machine", n)})] for n in ("one", "two")} == {"one": 0.0, "two": 1.0}


def test_it_answers_before_the_bundles_are_loaded() -> None:
    client = TestClient(create_app([load_bundle(TINY)], Settings()))  # its start-up has not run
    assert not any("machine" in dict(labels) for _, labels in scrape(client))


def test_openmetrics_where_it_is_asked_for(service: Service) -> None:
    service.warm()
    service.compensate()
    answer = service.client.get("/metrics", headers={"accept": "application/openmetrics-text; version=1.0.0"})
    assert answer.headers["content-type"].startswith("application/openmetrics-text")
    names = {family.name for family in parse_openmetrics(answer.text)}
    assert {"thermotrue_request_seconds", "thermotrue_samples", "thermotrue_sensor_ok", "process_cpu_seconds"} <= names
