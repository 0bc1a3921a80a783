"""Every error is a problem with one clear sentence."""

import json
from typing import Any

import pytest
from fastapi.testclient import TestClient
from service_client import MIDDLE, NOON, TINY, TINY_URL, Service, assert_problem, sample
from test_service_keys import ROUTES

from model.bundle import load_bundle
from model.exceptions import InputError
from service.app import create_app
from service.body_limit import MAX_BODY_BYTES
from service.schemas import MAX_POSITIONS_PER_REQUEST, MAX_SAMPLES_PER_REQUEST
from service.settings import Settings

JSON = {"content-type": "application/json"}


def positions(**changed: Any) -> dict[str, Any]:
    return {"positions": [MIDDLE, MIDDLE | changed]}


@pytest.mark.parametrize(
    ("body", "detail"),
    [
        (positions(X=800.5), "axis 'X' must lie within 0 and 800 mm, got 800.5 in positions[1]"),
        (positions(Z=-1e-9), "axis 'Z' must lie within 0 and 500 mm, got -1e-09 in positions[1]"),
        ({"positions": [{"X": 1, "Z": 2}]}, "axis 'Y' must be given in positions[0], got X, Z; give all axes"),
        (positions(x=1.0), "unknown axis 'x' in positions[1] for machine 'tiny'; known are X, Y, Z"),
        (positions(Y="12"), "key 'positions.1.Y' in the body: input should be a valid number, got '12'"),
        (positions(Y=True), "key 'positions.1.Y' in the body: input should be a valid number, got True"),
        (positions(Y=None), "key 'positions.1.Y' in the body: input should be a valid number, got None"),
        ({"positions": []}, "key 'positions' in the body: list should have at least 1 item"),
        ({}, "key 'positions' is missing in the body"),
        ({"position": [MIDDLE]}, "unknown key 'position' in the body; did you mean 'positions'?"),
        ([MIDDLE], "the body must be a JSON object, got [{'X': 400.0, "),
        (
            positions() | {"tool": {"lenght_mm": 3}},
            "unknown key 'tool.lenght_mm' in the body; did you mean 'length_mm'?",
        ),
        (positions() | {"tool": {"length_mm": -3}}, "key 'tool.length_mm' in the body: input should be greater"),
        (positions() | {"tool": {"length_mm": 1e6}}, "key 'tool.length_mm' in the body: input should be less"),
        (positions() | {"time": "noon"}, "key 'time' in the body: must be RFC 3339, such as 2026-"),
        (positions() | {"time": "2026-01-31T08:00:00"}, "key 'time' in the body: must carry its offset from UTC"),
        (positions() | {"time": NOON * 1000}, "key 'time' in the body: must lie between the years 1970 and 9999"),
        (positions() | {"time": -1}, "key 'time' in the body: must lie between the years 1970 and 9999"),
        (positions() | {"time": NOON + 1e5}, "key 'time' must not be more than 60 s ahead of the service's clock"),
        (positions() | {"channels": {}}, "key 'channels' must come with 'temperatures', got it alone"),
        (
            positions() | {"temperatures": {"colum": 20.0}},
            "unknown sensor 'colum' for machine 'tiny'; did you mean 'column'?",
        ),
        (
            positions() | {"temperatures": {"column": "20"}},
            "key 'temperatures.column' in the body: input should be",
        ),
    ],
)
def test_a_wrong_compensate_request_gets_one_sentence(service: Service, body: Any, detail: str) -> None:
    assert_problem(service.client.post(f"{TINY_URL}/compensate", json=body), 422, "invalid-request", detail)


@pytest.mark.parametrize("number", ["NaN", "1e999", "-Infinity", "1" + "0" * 400])
def test_coordinates_and_channels_must_be_finite(service: Service, number: str) -> None:
    body = f'{{"positions": [{{"X": {number}, "Y": 0, "Z": 0}}]}}'
    answer = service.client.post(f"{TINY_URL}/compensate", content=body, headers=JSON)
    assert_problem(answer, 422, "invalid-request", "key 'positions.0.X' in the body: input should be a ")
    body = f'{{"samples": [{{"time": {NOON}, "temperatures": {{}}, "channels": {{"spindle_rpm": {number}}}}}]}}'
    answer = service.client.post(f"{TINY_URL}/telemetry", content=body, headers=JSON)
    assert_problem(answer, 422, "invalid-request", "key 'samples.0.channels.spindle_rpm' in the body: input")


@pytest.mark.parametrize(
    ("change", "detail"),
    [
        (
            {"temperatures": {"ambeint": 20.0}},
            "unknown sensor 'ambeint' in samples[1] for machine 'tiny'; did you mean",
        ),
        (
            {"channels": {"spindel_rpm": 1}},
            "unknown channel 'spindel_rpm' in samples[1] for machine 'tiny'; did you",
        ),
        ({"temperature": {}}, "unknown key 'samples.1.temperature' in the body; did you mean 'temperatures'?"),
        ({"time": NOON + 1e5}, "key 'time' in samples[1] must not be more than 60 s ahead"),
        ({"time": None}, "key 'samples.1.time' in the body: must be RFC 3339"),
    ],
)
def test_one_wrong_sample_refuses_all(service: Service, change: dict[str, Any], detail: str) -> None:
    body = {"samples": [sample(NOON), sample(NOON + 1.0) | change]}
    assert_problem(service.client.post(f"{TINY_URL}/telemetry", json=body), 422, "invalid-request", detail)
    assert service.get()["telemetry_time"] is None


@pytest.mark.parametrize(
    ("query", "detail"),
    [
        ("X=1&Y=2", "axis 'Z' must be given in positions[0], got X, Y"),
        (
            "X=1&X=2&Y=2&Z=3",
            "each axis must be given once for every position, got X 2 times, Y 1 times, Z 1 times",
        ),
        ("X=1&Y=2&Z=3&W=4", "unknown axis 'W' in positions[0] for machine 'tiny'; known are X, Y, Z"),
        ("X=1&Y=2&Q=3", "unknown key 'Q' in the query"),
        ("X=1&Y=2&Z=no", "key 'Z.0' in the query: input should be a valid number"),
        ("X=1&Y=2&Z=nan", "key 'Z.0' in the query: input should be a finite number"),
        ("X=1&Y=2&Z=500.31", "axis 'Z' must lie within 0 and 500 mm, got 500.31 in positions[0]"),
        ("time=tomorrow", "key 'time' in the query: must be RFC 3339"),
        (f"time={NOON + 1e6}", "key 'time' in the query must not be more than 60 s ahead"),
    ],
)
def test_a_wrong_errors_query_gets_one_sentence(service: Service, query: str, detail: str) -> None:
    assert_problem(service.client.get(f"{TINY_URL}/errors?{query}"), 422, "invalid-request", detail)


def test_errors_takes_times_as_text_and_numbers(replayed: Service) -> None:
    for time in ("2027-01-15T08:00:30Z", NOON + 30.0):
        assert replayed.get("/errors", time=time)["time"] == "2027-01-15T08:00:30Z"


def test_names_that_lead_nowhere(service: Service) -> None:
    client = service.client
    assert_problem(
        client.get("/v1/machines/tinny"), 404, "unknown-machine", "unknown machine 'tinny'; did you mean 'tiny'?"
    )
    assert_problem(client.get("/v1/nothing"), 404, "not-found", "there is nothing at '/v1/nothing'")
    assert_problem(client.get("/v1/machines/"), 404, "not-found", "there is nothing at '/v1/machines/'")
    answer = client.get(f"{TINY_URL}/compensate")
    assert_problem(answer, 405, "method-not-allowed", f"'{TINY_URL}/compensate' must be called with POST, got GET")
    assert answer.headers["allow"] == "POST"
    answer = client.put(f"{TINY_URL}/datum")
    assert_problem(answer, 405, "method-not-allowed", f"'{TINY_URL}/datum' must be called with DELETE or POST, got PUT")
    assert answer.headers["allow"] == "DELETE, POST"


@pytest.mark.parametrize(
    ("content", "detail"),
    [
        (b"{", "the body must be JSON, got text that is not: Expecting property name"),
        (b"\xff\xfe{}", "the body must be JSON"),
        (b"[" * 100_000, "the body must be JSON"),
    ],
)
def test_a_body_that_is_not_json(service: Service, content: bytes, detail: str) -> None:
    answer = service.client.post(f"{TINY_URL}/compensate", content=content, headers=JSON)
    assert_problem(answer, 400, "malformed-body", detail)


def test_a_body_of_another_kind_or_none(service: Service) -> None:
    url = f"{TINY_URL}/compensate"
    answer = service.client.post(url, content="X,Y,Z", headers={"content-type": "text/csv"})
    assert_problem(answer, 415, "unsupported-media-type", "the content type must be application/json, got text/csv")
    assert_problem(service.client.post(url), 422, "invalid-request", "the body must be a JSON object, got none")


def test_half_a_surrogate_pair_is_quoted_and_not_fatal(service: Service) -> None:
    body = '{"positions": [{"X": 1, "Y": 1, "Z": 1}], "time": "\\ud800"}'
    answer = service.client.post(f"{TINY_URL}/compensate", content=body, headers=JSON)
    assert_problem(answer, 422, "invalid-request", "key 'time' in the body: must be RFC 3339")


def test_requests_have_a_largest_size(service: Service) -> None:
    url = f"{TINY_URL}/telemetry"
    whole = b" " * (MAX_BODY_BYTES + 1)
    detail = "the body must be at most 8388608 bytes, got more; send it in parts"
    assert_problem(service.client.post(url, content=whole, headers=JSON), 413, "request-entity-too-large", detail)
    parts = (b" " * 1_000_000 for _ in range(9))
    assert_problem(service.client.post(url, content=parts, headers=JSON), 413, "request-entity-too-large", detail)
    many = {"positions": [MIDDLE] * (MAX_POSITIONS_PER_REQUEST + 1)}
    answer = service.client.post(f"{TINY_URL}/compensate", json=many)
    assert_problem(answer, 422, "invalid-request", "key 'positions' in the body: list should have at most 2000 items")
    samples = {"samples": [sample(NOON)] * (MAX_SAMPLES_PER_REQUEST + 1)}
    answer = service.client.post(url, json=samples)
    assert_problem(answer, 422, "invalid-request", "key 'samples' in the body: list should have at most 4000 items")
    query = {axis: [1.0] * (MAX_POSITIONS_PER_REQUEST + 1) for axis in "XYZ"}
    answer = service.client.get(f"{TINY_URL}/errors", params=query)
    assert_problem(answer, 422, "invalid-request", "at most 2000 positions go into one request, got 2001")


def test_long_names_are_not_quoted_at_length(service: Service) -> None:
    body = {"positions": [MIDDLE | {"X" * 50_000: 1.0}]}
    answer = service.client.post(f"{TINY_URL}/compensate", json=body)
    assert_problem(answer, 422, "invalid-request", "key 'positions.0.XXXX")
    assert len(answer.text) < 1500


def test_datum_needs_a_thermal_state(service: Service) -> None:
    detail = "machine 'tiny' must have telemetry before it has a datum; post some first"
    assert_problem(service.client.post(f"{TINY_URL}/datum"), 409, "no-thermal-state", detail)


def test_our_own_mistakes_are_problems_too(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service.state, "outlook", lambda now_s: 1 / 0)
    answer = service.client.get(TINY_URL)
    assert_problem(answer, 500, "internal", "the service must answer every request, and failed on this one")


def test_not_ready_until_the_bundles_are_loaded() -> None:
    app = create_app([load_bundle(TINY)], Settings())
    client = TestClient(app)  # its start-up has not run
    assert client.get("/healthz").json() == {"status": "ok"}
    for path in ("/readyz", TINY_URL, "/v1/machines"):
        answer = client.get(path)
        assert_problem(answer, 503, "not-ready", "the bundles must be loaded before requests are answered")
        assert answer.headers["retry-after"] == "1"
    with client:
        assert client.get("/readyz").json() == {"status": "ready", "storage": "ok"}


def test_two_bundles_of_one_machine_are_refused() -> None:
    with pytest.raises(
        InputError, match=r"machine 'tiny' must be served from one bundle, got '.*' and '.*'; leave one"
    ):
        create_app([load_bundle(TINY), load_bundle(TINY)], Settings())


def test_the_description_promises_problems_and_no_validation_error(service: Service) -> None:
    described = service.client.get("/openapi.json").json()
    assert "HTTPValidationError" not in json.dumps(described)
    for path, methods in described["paths"].items():
        for method, operation in methods.items():
            assert "application/problem+json" in operation["responses"]["default"]["content"], (path, method)
    undescribed = ("/docs", "/openapi.json", "/page.")
    paths = {path for method, path in ROUTES if method != "WEBSOCKET"} - {"/"}
    expected = {path for path in paths if not path.startswith(undescribed)}
    assert set(described["paths"]) == expected
