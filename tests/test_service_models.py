"""Models uploaded, activated and rolled back; a broken one never replaces a working one."""

import threading
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bundles import packed, resealed
from fastapi.testclient import TestClient
from service_client import NOON, TINY, TINY_URL, Service, assert_problem, correction_um, sample, serving

from model.bundle import (
    GEOMETRY,
    MACHINE,
    MANIFEST,
    NETWORK,
    Bundle,
    load_bundle,
    parse_bundle,
    read_files,
    write_bundle,
)
from service.app import create_app
from service.settings import Settings
from service.store.store import open_store
from service.store.tables import model_files
from service.store.unavailable import StorageUnavailable

FILES = read_files(TINY)
MODELS = f"{TINY_URL}/models"
ZIP = {"content-type": "application/zip"}
Files = dict[str, bytes]


def other(growth_um: float = 5.0, rate: float = 60.0) -> Files:
    """Return another model of the tiny machine: more growth of the spindle when cold, perhaps a slower correction."""
    machine = FILES[MACHINE].replace(b"per_min = 60.0", f"per_min = {rate}".encode())
    return resealed({**FILES, MACHINE: machine, GEOMETRY: FILES[GEOMETRY] + f"EZ0T,,{growth_um}\n".encode()})


def version_of(files: Files) -> str:
    return parse_bundle(files, "other").version


def upload(service: Service, body: bytes | Files, kind: str = "application/zip", **query: Any) -> Any:
    content = packed(body) if isinstance(body, dict) else body
    return service.client.post(MODELS, content=content, headers={"content-type": kind}, params=query)


def listed(service: Service) -> dict[str, dict[str, Any]]:
    return {m["version"]: m for m in service.get("/models")["models"]}


TINY_VERSION = load_bundle(TINY).version


def test_the_command_lines_bundle_is_a_model(service: Service) -> None:
    wait_for(lambda: TINY_VERSION in listed(service) and listed(service)[TINY_VERSION]["kept"])
    only = listed(service)[TINY_VERSION]
    assert (only["origin"], only["added_by"], only["active"]) == ("command-line", "service", True)
    assert only["activated"] is not None


def wait_for(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + 10.0
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_upload_activate_and_roll_back(service: Service) -> None:
    service.warm()
    files = other()
    answer = upload(service, files)
    assert answer.status_code == 201, answer.text
    assert (answer.json()["model"]["version"], answer.json()["model"]["active"]) == (version_of(files), False)
    assert service.get()["model"] == TINY_VERSION
    again = upload(service, files)
    assert (again.status_code, len(listed(service))) == (201, 2)
    answer = service.client.post(f"{MODELS}/{version_of(files)}/activate")
    assert answer.status_code == 200, answer.text
    assert service.get()["model"] == version_of(files)
    assert [m["active"] for m in listed(service).values()] == [True, False]  # newest first
    answer = service.client.post(f"{MODELS}/rollback")
    assert (answer.status_code, answer.json()["model"]["version"]) == (200, TINY_VERSION)
    assert service.get()["model"] == TINY_VERSION
    assert service.client.post(f"{MODELS}/rollback").json()["model"]["version"] == version_of(files)
    actions = [e["action"] for e in service.get("/audit")["entries"]]
    assert actions[:4] == ["model rolled back", "model rolled back", "model activated", "model uploaded"]


def test_the_thermal_state_goes_with_it(service: Service) -> None:
    """What another network would predict after the same telemetry is what is predicted after the swap."""
    service.warm(28.0)
    before = service.state.thermal
    assert before is not None
    assert before.state is not None
    assert upload(service, other(), activate=True).status_code == 201
    after = service.state.thermal
    assert after is not before
    assert after is not None
    assert after.state is not None
    np.testing.assert_allclose(after.state.modes, before.state.modes, atol=1e-3)  # of 8; it goes back until that
    assert after.state.time_s == before.state.time_s


def test_the_correction_moves_to_the_new_prediction_no_faster_than_the_rate(service: Service) -> None:
    service.warm()
    start = correction_um(service.compensate())
    service.clock[0] += 3600.0  # however long nobody asked
    service.telemetry(sample(service.clock[0], 30.0))
    assert upload(service, other(100.0, rate=30.0), activate=True).status_code == 201
    moved = correction_um(service.compensate())
    assert np.abs(moved - start).max() < 0.01
    passed, last = 0.0, moved
    while passed < 600.0:
        service.clock[0] += 10.0
        passed += 10.0
        now = correction_um(service.compensate())
        assert np.abs(now - last).max() <= 30.0 * 10.0 / 60.0 + 1e-6
        last = now
    assert np.abs(last - start).max() == pytest.approx(100.0, abs=0.01)


def test_the_datum_is_set_anew_in_the_new_model(service: Service) -> None:
    """Relative to the moment of the datum nothing changes where both networks predict the same change."""
    service.warm(24.0)
    service.post("datum")
    service.clock[0] += 3600.0
    service.telemetry(*(sample(NOON + 600.0 * i, 24.0 + i) for i in range(1, 7)))

    def thermal() -> list[list[float]]:
        return [term["thermal"] for term in service.get("/errors")["terms"]]

    before = thermal()
    assert np.abs(np.concatenate(before)).max() > 1.0
    assert upload(service, other(), activate=True).json()["warnings"] == []
    assert (service.state.zero.kind, service.state.zero.time_s) == ("set", NOON)
    for one, two in zip(before, thermal(), strict=True):
        np.testing.assert_allclose(one, two, atol=0.01)


def broken(change: Callable[[dict[str, Any]], object]) -> Files:
    return resealed(FILES, change)


@pytest.mark.parametrize(
    ("files", "sentence"),
    [
        ({**FILES, NETWORK: FILES[NETWORK][:-1]}, "bundle 'upload': network.onnx does not match manifest.json"),
        ({**FILES, MANIFEST: b"{}"}, "bundle 'upload' has format version None"),
        ({n: FILES[n] for n in (MANIFEST, MACHINE)}, "bundle 'upload': geometry.csv is missing"),
        (
            resealed({n: FILES[n] for n in (MACHINE, GEOMETRY, MANIFEST)}, lambda m: m.update(network=None)),
            "bundle 'upload' must have a network",
        ),
        (resealed({**FILES, NETWORK: b"\x08"}), "bundle 'upload': network.onnx cannot be loaded"),
        (
            resealed({**FILES, GEOMETRY: FILES[GEOMETRY] + b"EZ0T,,1e300\n"}),
            "bundle 'upload': geometry.csv has a term beyond a metre",
        ),
        (
            broken(lambda m: m["network"]["parity"]["coefficients"].update(EZ0T=[[0.0]] * 8)),
            "bundle 'upload': network.onnx must return what it did",
        ),
        (
            resealed(
                {**FILES, MACHINE: FILES[MACHINE].replace(b'"tiny"', b'"other"')}, lambda m: m.update(machine="other")
            ),
            "bundle 'upload' must be of machine 'tiny', got one of 'other'",
        ),
        (
            resealed({**FILES, MACHINE: FILES[MACHINE].replace(b"-100.0", b"-99.0")}),
            "bundle 'upload': the machine's 'tool' must be as served",
        ),
        (
            resealed({**FILES, MACHINE: FILES[MACHINE].replace(b"800.0", b"900.0")}),
            "bundle 'upload': the machine's 'axes' must be as served",
        ),
        (
            resealed({**FILES, MACHINE: FILES[MACHINE].replace(b"300.0", b"200.0")}),
            "bundle 'upload': max_correction_um must be 300 as served, got 200",
        ),
        (
            resealed({**FILES, MACHINE: FILES[MACHINE].replace(b"= 60.0", b"= 61.0")}),
            "bundle 'upload': max_rate_um_per_min must be at most 60 as served, got 61",
        ),
        (
            resealed({**FILES, MACHINE: FILES[MACHINE].replace(b"[-10.0, 50.0]", b"[-10.0, 51.0]")}),
            "bundle 'upload': the bounds of sensor 'ambient' must be as served or narrower",
        ),
        (
            resealed({**FILES, MACHINE: FILES[MACHINE] + b"[sensors.oil]\n"}),
            "bundle 'upload' must have the machine's sensors, got a difference in 'oil'",
        ),
    ],
)
def test_a_broken_bundle_changes_nothing(service: Service, files: Files, sentence: str) -> None:
    service.warm()
    thermal, reply = service.state.thermal, service.compensate()
    assert_problem(upload(service, files, activate=True), 422, "broken-bundle", sentence)
    assert service.state.thermal is thermal
    assert service.compensate() == reply
    assert set(listed(service)) <= {TINY_VERSION}


def test_what_else_is_refused(service: Service) -> None:
    assert_problem(upload(service, b"{}", kind="application/json"), 415, "unsupported-media-type", "the content type")
    unknown = service.client.post(f"{MODELS}/0123/activate")
    assert_problem(unknown, 404, "unknown-model", "unknown model '0123' of machine 'tiny'; there are")
    early = service.client.post(f"{MODELS}/rollback")
    assert_problem(early, 409, "no-earlier-model", "machine 'tiny' must have had another model to go back to")
    active = service.client.delete(f"{MODELS}/{TINY_VERSION}")
    assert_problem(active, 409, "model-active", f"model '{TINY_VERSION}' of machine 'tiny' is active")


def test_a_model_that_is_not_active_is_deleted(service: Service) -> None:
    files = other()
    upload(service, files)
    assert service.client.delete(f"{MODELS}/{version_of(files)}").status_code == 204
    assert set(listed(service)) == {TINY_VERSION}
    assert_problem(service.client.post(f"{MODELS}/{version_of(files)}/activate"), 404, "unknown-model")


def test_the_number_of_models_is_bounded(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.models.shelf.MAX_MODELS", 2)
    assert upload(service, other(1.0)).status_code == 201
    assert_problem(upload(service, other(2.0)), 409, "too-many-models", "machine 'tiny' must have at most 2 models")
    assert upload(service, other(1.0)).status_code == 201


def test_a_machine_without_a_network_may_get_one(tmp_path: Path) -> None:
    cold = write_bundle(tmp_path / "cold", load_bundle(TINY).machine)
    with serving(cold) as service:
        assert service.get()["status"] == "geometric_only"
        assert upload(service, other(), activate=True).status_code == 201
        service.warm(26.0)
        assert service.get()["status"] == "ok"
        assert service.client.post(f"{MODELS}/rollback").status_code == 200
        assert service.get()["status"] == "geometric_only"


def restarted(database: str, bundle: Bundle) -> Any:
    return TestClient(create_app([bundle], Settings(database=database)))


def test_a_restart_keeps_what_was_active(tmp_path: Path) -> None:
    database, files, tiny = f"sqlite:///{tmp_path / 'db'}", other(), load_bundle(TINY)
    with restarted(database, tiny) as client:
        answer = client.post(
            f"{MODELS}?activate=true", content=packed(files), headers={"content-type": "application/zip"}
        )
        assert answer.status_code == 201, answer.text
    with restarted(database, tiny) as client:
        assert client.get(TINY_URL).json()["model"] == version_of(files)
        client.post(f"{MODELS}/rollback")
    with restarted(database, tiny) as client:
        assert client.get(TINY_URL).json()["model"] == TINY_VERSION
        client.post(f"{MODELS}/rollback")
    fresh = tmp_path / "fresh"  # somebody put a new bundle there
    fresh.mkdir()
    for name, content in other(7.0).items():
        (fresh / name).write_bytes(content)
    with restarted(database, load_bundle(fresh)) as client:
        assert client.get(TINY_URL).json()["model"] == version_of(other(7.0))
        assert client.post(f"{MODELS}/{TINY_VERSION}/activate").status_code == 200


@pytest.mark.parametrize("harm", ["content", "missing"])
def test_a_stored_model_that_does_not_load_does_not_serve(
    tmp_path: Path, harm: str, caplog: pytest.LogCaptureFixture
) -> None:
    database, tiny = f"sqlite:///{tmp_path / 'db'}", load_bundle(TINY)
    with restarted(database, tiny) as client:
        client.post(f"{MODELS}?activate=true", content=packed(other()), headers=ZIP)
    with open_store(database) as store, store.engine.begin() as connection:
        of_network = model_files.c.name == NETWORK
        if harm == "content":
            connection.execute(model_files.update().where(of_network).values(content=b"damaged"))
        else:
            connection.execute(model_files.delete().where(of_network))
    with restarted(database, tiny) as client:
        assert client.get(TINY_URL).json()["model"] == TINY_VERSION
        active = [m["version"] for m in client.get(MODELS).json()["models"] if m["active"]]
        assert active == [TINY_VERSION]
    assert "stored model cannot be served" in caplog.text


def test_a_damaged_stored_model_is_not_activated(service: Service) -> None:
    files = other()
    upload(service, files)
    store = service.client.app.state.store  # type: ignore[attr-defined]
    with store.engine.begin() as connection:
        connection.execute(model_files.update().where(model_files.c.name == NETWORK).values(content=b"damaged"))
    answer = service.client.post(f"{MODELS}/{version_of(files)}/activate")
    assert_problem(
        answer, 409, "model-not-usable", f"bundle 'database/tiny/{version_of(files)}': network.onnx does not"
    )
    assert service.get()["model"] == TINY_VERSION


def test_while_the_database_fails_nothing_is_changed(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    service.warm(26.0)
    files = other()
    upload(service, files)
    before = service.compensate()
    store = service.client.app.state.store  # type: ignore[attr-defined]

    async def fails(_: float) -> None:
        raise StorageUnavailable("and fails: disk full")

    monkeypatch.setattr(store.journal, "durable", fails)
    for what in (f"{version_of(files)}/activate", ""):
        answer = service.client.post(f"{MODELS}/{what}".rstrip("/"), content=packed(other(9.0)), headers=ZIP)
        assert_problem(answer, 503, "storage-unavailable", "the database must take writes, and fails: disk full")
        assert answer.headers["retry-after"]
    assert service.get()["model"] == TINY_VERSION
    assert service.compensate()["points"] == before["points"]


def test_a_swap_under_load_fails_no_request_and_holds_the_rate(service: Service) -> None:
    service.warm()
    files = [other(20.0), other(40.0)]
    for one in files:
        assert upload(service, one).status_code == 201
    stop, problems, seen = threading.Event(), list[str](), list[tuple[float, Any]]()

    def ask() -> None:
        while not stop.is_set():
            service.clock[0] += 0.5
            for what, body in (
                ("telemetry", {"samples": [sample(service.clock[0], 30.0)]}),
                ("compensate", {"positions": [{"X": 400.0, "Y": 250.0, "Z": 250.0}]}),
            ):
                answer = service.client.post(f"{TINY_URL}/{what}", json=body)
                if answer.status_code != 200:
                    problems.append(answer.text)
            seen.append((service.clock[0], correction_um(answer.json())))

    asking = threading.Thread(target=ask)
    asking.start()
    for round_ in range(6):
        answer = service.client.post(f"{MODELS}/{version_of(files[round_ % 2])}/activate")
        assert answer.status_code == 200, answer.text
        time.sleep(0.05)
    stop.set()
    asking.join()
    assert not problems
    assert len(seen) > 10
    for (t0, before), (t1, after) in pairwise(seen):
        assert np.abs(after - before).max() <= 60.0 * (t1 - t0) / 60.0 + 1e-6
    assert service.state.thermal is not None
    assert service.state.thermal.state is not None
    assert service.state.thermal.state.time_s == service.clock[0]
