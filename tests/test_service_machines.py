import logging
from dataclasses import replace
from pathlib import Path

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from machines import five_axis_text
from service_client import MIDDLE, NOON, TINY, TINY_URL, assert_problem, sample, serving

from model.bundle import Bundle, load_bundle, write_bundle
from model.error_map import ErrorMap
from model.exceptions import BundleError, InputError
from model.machine import parse_machine
from service import docs
from service.app import create_app
from service.logs import JsonLines
from service.machine_state import MachineState
from service.settings import Settings, read_settings
from service.timestamps import format_time, parse_time


@pytest.fixture
def cold(tmp_path: Path) -> Bundle:
    """The tiny machine without its network."""
    rows = [("EXX", 0.0, 0.0), ("EXX", 800.0, 12.0)]
    return write_bundle(tmp_path / "cold", load_bundle(TINY).machine, geometry=rows)


def test_what_is_served() -> None:
    with serving() as service:
        [listed] = service.client.get("/v1/machines").json()["machines"]
        shown = service.get()
    assert listed == shown
    bundle = load_bundle(TINY)
    assert (shown["machine"], shown["model"], shown["channels"]) == ("tiny", bundle.version, ["spindle_rpm"])
    assert shown["axes"]["X"] == {"range_mm": [0.0, 800.0]}
    assert [t["term"] for t in shown["terms"]] == [t.name for t in bundle.machine.terms]
    assert shown["sensors"]["column"] == {
        "range_degC": [-10.0, 60.0],
        "max_rate_degC_per_min": 20.0,
        "used": True,
        "valid_range_degC": [15.0, 35.0],
        "taken_degC": None,
        "fault": None,
    }
    assert shown["limits"] == {"max_correction_um": 300.0, "max_rate_um_per_min": 60.0}
    assert shown["telemetry_time"] is None


def test_a_bundle_without_a_network_is_served_as_a_geometric_machine(cold: Bundle) -> None:
    with serving(cold) as service:
        reply = service.telemetry(sample(NOON))
        assert (reply["accepted"], reply["ignored"], reply["status"]) == (0, 1, "geometric_only")
        assert reply["warnings"] == ["machine 'tiny' has no network, so telemetry does not change its correction"]
        reply = service.compensate()
        assert (reply["status"], reply["warnings"]) == ("geometric_only", [])
        assert reply["points"][0]["correction"]["X"] == pytest.approx(0.006, abs=1e-6)
        assert service.get("/errors")["reliability"] == 0.0
        assert service.get()["datum"] == {"kind": "absolute", "time": None}
        detail = "machine 'tiny' has no network, so it has no thermal state to take as a datum"
        assert_problem(service.client.post(f"{TINY_URL}/datum"), 409, "no-thermal-state", detail)
        assert_problem(service.client.delete(f"{TINY_URL}/datum"), 409, "no-thermal-state", detail)


def test_a_network_that_cannot_be_loaded_is_named() -> None:
    with pytest.raises(BundleError, match=r"bundle '.*tiny_bundle': network.onnx cannot be loaded: "):
        create_app([replace(load_bundle(TINY), network=b"not a network")], Settings())


def test_machines_whose_rate_cannot_be_bounded_yet_are_refused(tmp_path: Path) -> None:
    bundle = write_bundle(tmp_path / "five", parse_machine(five_axis_text("w C A Y X b Z t")))
    with pytest.raises(BundleError, match=r"bundle '.*': a machine to serve must have linear .*, got rotary axes A, C"):
        MachineState(bundle, Settings(), lambda: NOON, lambda: NOON)


def test_geometry_of_no_machine_is_refused(cold: Bundle) -> None:
    huge = ErrorMap.from_rows(cold.machine, [("EX0X", None, 2e6)])
    wild = replace(cold, geometry=huge.scaled(1e6))
    with pytest.raises(BundleError, match=r"bundle '.*cold': geometry.csv has a term beyond a metre"):
        create_app([wild], Settings())


def test_settings_come_from_the_environment_and_options_override(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("THERMOTRUE_PORT", "8123")
    monkeypatch.setenv("THERMOTRUE_BUNDLES", "/bundles/a:/bundles/b")
    monkeypatch.setenv("THERMOTRUE_STALE_AFTER_S", "30")
    settings = read_settings(port=9000)
    assert (settings.port, settings.stale_after_s, settings.host) == (9000, 30.0, "127.0.0.1")
    assert settings.bundles == (Path("/bundles/a"), Path("/bundles/b"))
    monkeypatch.setenv("THERMOTRUE_STALE_AFTER_S", "soon")
    with pytest.raises(
        InputError,
        match=r"key 'stale_after_s' in the settings \(environment variable .* got 'soon'",
    ):
        read_settings()


def test_times_survive_the_wire() -> None:
    for time_s in (0.0, NOON, NOON + 0.123456, 4e9):
        assert parse_time(format_time(time_s)) == pytest.approx(time_s, abs=1e-6)
    for wrong in ("12:00", "", True, None, [], float("nan"), float("inf"), -1, 1e15):
        with pytest.raises(ValueError, match=r"must (be RFC 3339|lie between)"):
            parse_time(wrong)


def test_docs_need_nothing_from_the_internet() -> None:
    app = FastAPI(docs_url=None)
    docs.install(app)
    client = TestClient(app)
    page = client.get("/docs").text
    assert "http://" not in page
    assert "https://" not in page
    for name in (docs.SCRIPT, docs.STYLE, docs.ICON):
        assert f"/docs/assets/{name}" in page
        assert client.get(f"/docs/assets/{name}").status_code == 200


def test_a_log_line_is_one_json_object() -> None:
    record = logging.LogRecord("service", logging.INFO, "file", 1, "sensor replaced", None, None)
    record.sensor = "bed\nfront"
    line = JsonLines().format(record)
    assert "\n" not in line
    assert line.endswith('"level": "info", "event": "sensor replaced", "sensor": "bed\\nfront"}')


def test_a_fault_that_lasts_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    with serving() as service, caplog.at_level(logging.INFO, logger="service"):
        caplog.clear()
        service.telemetry(*(sample(NOON + i, column=None) for i in range(20)))
        service.telemetry(sample(NOON + 30.0))
        for _ in range(5):
            service.compensate([MIDDLE])
    events = [r.getMessage() for r in caplog.records if r.name.startswith("service")]
    assert events.count("sensor replaced") == 1
    assert events.count("sensor back") == 1
    assert events.count("status changed") == 1
