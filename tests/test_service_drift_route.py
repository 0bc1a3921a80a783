"""`/measurements`: what was probed is compared with what was predicted then, stored, and watched."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from service_client import MIDDLE, TINY, TINY_URL, Service, assert_problem, sample, serving
from uncertain_bundle import uncertain_bundle

from model.bundle import load_bundle
from service.app import create_app
from service.measurements.drift import REFERENCE, SESSION_S
from service.measurements.history import EVERY_S, KEPT_S
from service.settings import Settings
from service.store.store import open_store

CORNER = {"X": 750.0, "Y": 20.0, "Z": 480.0}
URL = f"{TINY_URL}/measurements"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return uncertain_bundle(tmp_path_factory.mktemp("bundle"))


@pytest.fixture
def known(folder: Path) -> Iterator[Service]:
    with serving(load_bundle(folder)) as running:
        running.warm(24.0)
        yield running


def deviation(service: Service, position: dict[str, float] | None = None, **more: Any) -> dict[str, float]:
    found: dict[str, float] = service.compensate([position or MIDDLE], **more)["points"][0]["deviation_um"]
    return found


def probed(
    service: Service, off: dict[str, float], position: dict[str, float] | None = None, **more: Any
) -> dict[str, Any]:
    """Post a probing of the present prediction that is off by so much."""
    now = deviation(service, position)
    measured = {k: now[k] + v for k, v in off.items()}
    return post(service, {"time": service.clock[0], "position": position or MIDDLE, "deviation_um": measured, **more})


def post(service: Service, *measurements: dict[str, Any]) -> dict[str, Any]:
    return service.post("measurements", {"measurements": measurements})


def one(time: float, **more: Any) -> dict[str, Any]:
    return {"time": time, "position": MIDDLE, "deviation_um": {"x": 1.0}} | more


@pytest.mark.parametrize("position", [MIDDLE, CORNER])
def test_without_compensation_the_machine_is_measured(known: Service, position: dict[str, float]) -> None:
    [found] = probed(known, {"x": 3.0, "z": -1.5}, position)["measurements"]
    assert found["residual_um"]["x"] == pytest.approx(3.0, abs=1e-3)
    assert found["residual_um"]["y"] is None
    assert found["residual_um"]["z"] == pytest.approx(-1.5, abs=1e-3)
    assert found["note"] is None
    assert found["interval_um"] > known.compensate([position])["points"][0]["uncertainty_um"]


def test_a_probes_own_uncertainty_widens_the_interval(known: Service) -> None:
    alone = known.compensate()["points"][0]["uncertainty_um"]
    for own in (0.0, 3.0, 50.0):
        [found] = probed(known, {"x": 0.0}, uncertainty_um=own)["measurements"]
        assert found["interval_um"] == pytest.approx(np.hypot(alone, own), rel=1e-6)


def test_with_compensation_only_what_was_left_is_measured(known: Service) -> None:
    deviation(known)  # the correction is active
    known.clock[0] += 60.0
    known.telemetry(sample(known.clock[0], 24.0))
    known.compensate()
    [found] = post(known, one(known.clock[0], compensated=True, deviation_um={"x": 2.0}))["measurements"]
    assert found["predicted_um"] == {k: pytest.approx(0.0, abs=1e-3) for k in "xyz"}
    assert found["residual_um"]["x"] == pytest.approx(2.0, abs=1e-3)


def test_a_correction_on_its_way_says_nothing_of_the_prediction(known: Service) -> None:
    known.compensate()
    known.clock[0] += 1.0
    known.post("datum")  # which moves the target by tens of micrometres
    known.compensate()
    [found] = post(known, one(known.clock[0], compensated=True))["measurements"]
    assert found["residual_um"] is None
    assert found["note"].startswith("the correction had not arrived")


def test_a_tool_of_another_length_is_another_deviation(known: Service) -> None:
    long = deviation(known, CORNER, tool={"length_mm": 400.0})
    assert long["x"] != pytest.approx(deviation(known, CORNER)["x"], abs=1.0)
    body = one(known.clock[0], position=CORNER, tool={"length_mm": 400.0}, deviation_um=long)
    [found] = post(known, body)["measurements"]
    assert found["residual_um"] == {k: pytest.approx(0.0, abs=1e-3) for k in "xyz"}


def test_a_past_time_is_compared_with_the_prediction_of_then(known: Service) -> None:
    """While the machine warms up; between two samples the prediction is linear."""
    then = {}
    for minute in range(120):
        known.clock[0] += 60.0
        known.telemetry(sample(known.clock[0], 24.0 + minute / 20.0))
        then[known.clock[0]] = deviation(known, CORNER)
    times = list(then)
    for before, after in ((times[40], times[41]), (times[100], times[101])):
        for share in (0.0, 0.25):
            time = before + share * (after - before)
            wanted = {k: then[before][k] * (1 - share) + then[after][k] * share for k in "xyz"}
            [found] = post(known, one(time, position=CORNER, deviation_um=wanted))["measurements"]
            assert found["residual_um"] == {k: pytest.approx(0.0, abs=2e-3) for k in "xyz"}
            assert abs(then[before]["z"] - then[times[-1]]["z"]) > 1.0


def test_history_is_bounded(known: Service) -> None:
    count = 3 * round(KEPT_S / 20.0) // 2
    known.clock[0] += 20.0 * count
    known.telemetry(*(sample(known.clock[0] - 20.0 * k, 24.0) for k in range(count)))
    first_s = known.state.history.from_s
    assert first_s is not None
    assert KEPT_S - EVERY_S <= known.clock[0] - first_s <= KEPT_S + EVERY_S
    assert post(known, one(first_s))["measurements"]
    answer = known.client.post(URL, json={"measurements": [one(known.clock[0]), one(first_s - 1.0)]})
    assert_problem(answer, 422, "invalid-request", "key 'time' in measurements[1] must lie within what is known of the")
    assert len(known.get("/measurements")["measurements"]) == 1  # all or none


def test_what_is_wrong_is_refused(known: Service) -> None:
    now = known.clock[0]
    for body, detail in (
        (one(now + 3600.0), "key 'time' in measurements[0] must not be more than 60 s ahead"),
        (one(now, position={"X": 1.0, "Y": 1.0}), "axis 'Z' must be given in measurements[0].position"),
        (one(now, position=MIDDLE | {"X": 1e4}), "axis 'X' must lie within 0 and 800 mm, got 10000 in measurements[0]"),
        (one(now, deviation_um={}), "key 'measurements.0.deviation_um' in the body: must have at least one of x, y"),
        (one(now, deviation_um={"x": 1e9}), "key 'measurements.0.deviation_um.x' in the body"),
        (one(now, uncertainty_um=-1.0), "key 'measurements.0.uncertainty_um' in the body"),
    ):
        assert_problem(known.client.post(URL, json={"measurements": [body]}), 422, "invalid-request", detail)
    assert known.get("/measurements")["measurements"] == []


def test_a_machine_without_a_prediction_has_nothing_to_compare(tmp_path: Path) -> None:
    with serving(load_bundle(TINY)) as cold:
        answer = cold.client.post(URL, json={"measurements": [one(cold.clock[0])]})
        assert_problem(
            answer, 409, "no-thermal-state", "machine 'tiny' must have a prediction to compare with, and has"
        )
        assert cold.get("/measurements")["measurements"] == []


def test_a_bundle_that_does_not_know_itself_compares_and_does_not_judge(service: Service) -> None:
    service.warm()
    reply = probed(service, {"x": 500.0})
    [found] = reply["measurements"]
    assert found["residual_um"]["x"] == pytest.approx(500.0, abs=1e-3)
    assert found["interval_um"] is None
    assert found["note"].startswith("the bundle does not say how far predictions may be off")
    assert not reply["drift"]["drifting"]


def test_they_are_listed_newest_first_from_a_time_on(known: Service) -> None:
    times = [known.clock[0] - 60.0 * k for k in (2, 0, 3, 1)]
    post(known, *(one(t) for t in times))
    assert [m["time"][14:16] for m in known.get("/measurements")["measurements"]] == ["00", "59", "58", "57"]
    assert len(known.get("/measurements", limit=2)["measurements"]) == 2
    assert len(known.get("/measurements", since=known.clock[0] - 100.0)["measurements"]) == 2


def next_session(service: Service) -> None:
    service.clock[0] += SESSION_S
    service.telemetry(sample(service.clock[0], 24.0))


def test_a_machine_that_drifts_says_so_and_one_that_does_not_does_not(known: Service) -> None:
    width = known.compensate()["points"][0]["uncertainty_um"]
    rng = np.random.default_rng(0)
    for off in (0.0, 2.0 * width):
        for _ in range(REFERENCE + 8 if off == 0.0 else 10):
            next_session(known)
            reply = probed(known, {"x": off + rng.normal(0.0, width / 2.0), "z": rng.normal(0.0, width / 2.0)})
        assert reply["drift"]["drifting"] == (off > 0.0)
    drift = reply["drift"]
    assert drift["running_residual_um"]["x"] == pytest.approx(off, rel=0.35)
    assert drift["running_residual_um"]["x"] > drift["limit_um"]["x"]
    assert drift["running_residual_um"]["y"] is None
    assert drift["trend_um_per_day"]["x"] > 3.0 * drift["trend_standard_error_um_per_day"]["x"]
    reply = known.compensate()
    assert reply["status"] == "drifting"
    assert any(w.startswith("drifting: probed deviations differ from the prediction by +") for w in reply["warnings"])
    text = known.client.get("/metrics").text
    assert 'thermotrue_drifting{machine="tiny"} 1.0' in text
    assert 'thermotrue_status{machine="tiny",status="drifting"} 1.0' in text
    for name in ("residual_um", "residual_limit_um", "residual_trend_um_per_day"):
        assert f'thermotrue_{name}{{component="x",machine="tiny"}}' in text
        assert f'thermotrue_{name}{{component="y",machine="tiny"}}' not in text


def test_a_restart_restores_the_monitor(folder: Path, tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/drift.sqlite"
    with serving(load_bundle(folder), database=url) as before:
        before.warm(24.0)
        for n in range(REFERENCE + 3):
            next_session(before)
            reply = probed(before, {"x": float(n), "y": -2.0 * n})
        assert reply["drift"]["sessions"] == REFERENCE + 3
    with open_store(url) as store:
        app = create_app([load_bundle(folder)], Settings(), store=store)
        from fastapi.testclient import TestClient

        with TestClient(app) as client:
            after = client.get(URL).json()
    assert after["drift"] == reply["drift"]
    assert len(after["measurements"]) == REFERENCE + 3


def test_another_model_starts_anew(known: Service) -> None:
    for _ in range(REFERENCE + 1):
        next_session(known)
        probed(known, {"x": 0.0})
    assert known.get("/measurements")["drift"]["sessions"] == REFERENCE + 1
    monitor = known.state.monitor
    assert monitor.drift("another version").components[0].sessions == 0
    assert monitor.conditions("another version") == ()
