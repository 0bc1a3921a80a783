from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from service_client import MIDDLE, NOON, TINY, TINY_URL, Service, assert_problem, correction_um, sample, serving

from model.bundle import load_bundle
from model.exceptions import ComputeError
from service.app import create_app
from service.guard import CARRY_S
from service.settings import Settings


def test_samples_may_come_in_any_order_and_twice() -> None:
    samples = [sample(NOON - 60.0 * i, 20.0 + i) for i in range(8)]
    with serving() as ordered, serving() as mixed:
        ordered.telemetry(*reversed(samples))
        reply = mixed.telemetry(*samples[4:], *samples[:4], samples[2])
        assert (reply["accepted"], reply["ignored"]) == (8, 1)
        assert "1 of 9 samples are no newer than the thermal state and were ignored" in reply["warnings"]
        assert correction_um(ordered.compensate()).tolist() == correction_um(mixed.compensate()).tolist()


def test_late_samples_change_nothing_and_are_counted(service: Service) -> None:
    service.telemetry(sample(NOON))
    reply = service.telemetry(sample(NOON - 1.0, 25.0), sample(NOON, 25.0), sample(NOON + 1.0))
    assert (reply["accepted"], reply["ignored"]) == (1, 2)


def test_times_are_rfc_3339_or_epoch_seconds(service: Service) -> None:
    service.telemetry(sample(NOON), sample(0) | {"time": "2027-01-15T16:00:10+08:00"})
    assert service.get()["telemetry_time"] == "2027-01-15T08:00:10Z"


@pytest.mark.parametrize("reading", ["NaN", "1e999", "-Infinity", "null"])
def test_a_reading_that_is_no_number_is_replaced_and_the_sample_kept(service: Service, reading: str) -> None:
    service.warm(degC=22.0, end=NOON - CARRY_S - 1.0)  # after so long its last reading is not carried on
    body = (
        f'{{"samples": [{{"time": {NOON}, "channels": {{"spindle_rpm": 0}}, '
        f'"temperatures": {{"spindle": {reading}, "column": 22, "ambient": 22}}}}]}}'
    )
    headers = {"content-type": "application/json"}
    reply = service.client.post(f"{TINY_URL}/telemetry", content=body, headers=headers).json()
    assert (reply["accepted"], reply["status"]) == (1, "degraded")
    assert reply["warnings"][0].startswith("sensor 'spindle' ")
    assert reply["warnings"][0].endswith("; replaced by its estimate")
    answer = service.compensate()
    [warning] = answer["warnings"]
    thermal = service.state.thermal
    assert thermal is not None
    assert thermal.state is not None
    estimate = thermal.predictor.sensor_model.fill(np.array([np.nan, 22.0, 22.0]))[0]
    assert thermal.state.inputs[0] == pytest.approx(estimate)
    assert warning.endswith(f"replaced by its estimate {estimate:.1f} °C")
    assert 0.0 < service.get("/errors")["reliability"] < 1.0  # one of three


def test_a_fault_is_reported_once_for_a_whole_batch(service: Service) -> None:
    reply = service.telemetry(*(sample(NOON - 60.0 * i, 20.0, column=None) for i in range(5)))
    assert reply["warnings"] == ["sensor 'column' has no reading; replaced by its estimate (5 samples)"]
    assert service.get()["sensors"]["column"]["fault"] == "has no reading"
    service.telemetry(sample(NOON + 60.0))
    assert service.get()["sensors"]["column"]["fault"] is None


def test_all_sensors_gone_leave_the_temperatures_as_they_were(service: Service) -> None:
    service.warm(degC=24.0, end=NOON - 60.0)
    service.telemetry(sample(NOON, spindle=None, column=None, ambient=999.0))
    thermal = service.state.thermal
    assert thermal is not None
    assert thermal.state is not None
    assert thermal.state.time_s == NOON
    np.testing.assert_array_equal(thermal.state.inputs[:3], 24.0)
    assert service.get("/errors")["reliability"] == 0.0


def test_the_state_does_not_start_from_a_guess(service: Service) -> None:
    reply = service.telemetry(sample(NOON, 20.0, spindle=None, column=None))
    assert (reply["accepted"], reply["ignored"], reply["status"]) == (0, 1, "geometric_only")
    assert "1 of 1 samples were not used: 2 of 3 sensors have no plausible reading to start from" in reply["warnings"]
    assert service.telemetry(sample(NOON + 1.0))["accepted"] == 1


def test_a_missing_channel_is_held(service: Service) -> None:
    service.telemetry(sample(NOON, rpm=4000.0))
    reply = service.telemetry(sample(NOON + 60.0) | {"channels": {}})
    assert reply["warnings"] == ["channel 'spindle_rpm' has no value; taken as 4000"]
    assert service.compensate()["warnings"][0] == "channel 'spindle_rpm' has no value; taken as 4000"


def test_statuses_and_the_most_serious_of_them(replayed: Service) -> None:
    assert replayed.get()["status"] == "geometric_only"
    replayed.telemetry(sample(NOON - 60.0), sample(NOON))
    assert replayed.get()["status"] == "warming_up"
    assert replayed.get()["warnings"] == [
        "telemetry has run for 1 min; the thermal state at its start is forgotten after 60 min"
    ]
    replayed.telemetry(sample(NOON + 60.0, column=None))
    replayed.clock[0] = NOON + 60.0
    assert replayed.get()["status"] == "degraded"
    replayed.telemetry(sample(NOON + 3600.0, 31.0, column=None))
    replayed.clock[0] = NOON + 3600.0
    reply = replayed.get()
    assert reply["status"] == "extrapolating"
    assert [w.split(" ")[1] for w in reply["warnings"]] == ["'ambient'", "'column'"]
    replayed.clock[0] = NOON + 7200.0
    assert replayed.get()["status"] == "stale"


def test_temperatures_far_from_training_take_the_thermal_part_away(replayed: Service) -> None:
    replayed.warm(degC=30.0, hours=1)
    assert replayed.get("/errors")["reliability"] == 1.0
    replayed.telemetry(sample(NOON + 3600.0, 36.0))  # ambient: trained up to 30 °C, over 15 K
    assert replayed.get("/errors")["reliability"] == pytest.approx((7.5 - 6.0) / 5.5)
    replayed.telemetry(sample(NOON + 7200.0, 40.0))
    assert replayed.get("/errors")["reliability"] == 0.0


def test_a_network_that_fails_loses_the_sample_and_not_the_state(
    replayed: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    replayed.warm(degC=25.0)
    before = correction_um(replayed.compensate())
    assert replayed.state.thermal is not None

    def fail(*_: object) -> None:
        raise ComputeError("the network must return finite numbers, got none")

    with monkeypatch.context() as patch:
        patch.setattr(replayed.state.thermal.predictor, "step", fail)
        reply = replayed.telemetry(sample(NOON + 60.0, 25.0))
        assert (reply["accepted"], reply["ignored"], reply["status"]) == (0, 1, "degraded")
        assert reply["warnings"] == ["1 of 1 samples were not used: the network must return finite numbers, got none"]
        np.testing.assert_array_equal(correction_um(replayed.compensate()), before)
    assert replayed.telemetry(sample(NOON + 120.0, 25.0))["status"] == "ok"


def test_datum_makes_the_present_the_zero_and_moves_there_at_the_rate(service: Service) -> None:
    with serving(replay=True) as cold:
        geometric = correction_um(cold.compensate())
    service.clock[0] -= 7200.0
    service.compensate()  # served long before, so the rate is counted from the last time only
    service.clock[0] += 7200.0
    service.warm(degC=30.0)
    warm = correction_um(service.compensate())
    assert service.get()["datum"] == {"kind": "absolute", "time": None}
    assert service.post("datum")["datum"] == {"kind": "set", "time": "2027-01-15T08:00:00Z"}
    np.testing.assert_array_equal(correction_um(service.compensate()), warm)  # no time has passed
    service.clock[0] += 300.0
    np.testing.assert_allclose(correction_um(service.compensate()), geometric, atol=1e-3)
    assert service.client.delete(f"{TINY_URL}/datum").json()["datum"] == {"kind": "absolute", "time": None}
    service.clock[0] += 300.0
    np.testing.assert_allclose(correction_um(service.compensate()), warm, atol=1e-3)


def test_a_network_of_changes_starts_at_its_first_sample_and_returns_there() -> None:
    bundle = load_bundle(TINY)
    assert bundle.manifest.network is not None
    record = bundle.manifest.network.model_copy(update={"datum": "run-start"})
    changes = replace(bundle, manifest=bundle.manifest.model_copy(update={"network": record}))
    with serving(changes) as service:
        assert service.get()["datum"] == {"kind": "run-start", "time": None}
        geometric = correction_um(service.compensate())
        service.telemetry(sample(NOON, 28.0))
        started = {"kind": "run-start", "time": "2027-01-15T08:00:00Z"}
        assert service.get()["datum"] == started
        assert service.compensate()["points"][0]["limited"] is False
        np.testing.assert_allclose(correction_um(service.compensate()), geometric, atol=1e-3)
        service.post("datum")
        assert service.client.delete(f"{TINY_URL}/datum").json()["datum"] == started


SECONDS = st.sampled_from([-3600.0, 0.0, 0.1, 5.0, 60.0, 900.0, 7200.0])
READING = st.none() | st.floats() | st.floats(10.0, 50.0)
EVENTS = st.lists(
    st.tuples(st.just("sample"), SECONDS, st.tuples(READING, READING, READING), st.floats(0.0, 1e6))
    | st.tuples(st.sampled_from(["datum", "absolute"]))
    | st.tuples(st.just("correct"), SECONDS, st.none() | st.floats(0.0, 400.0)),
    max_size=12,
)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(EVENTS)
def test_no_telemetry_makes_the_served_correction_jump_or_leave_its_limits(events: list[Any]) -> None:
    from service.schemas import Sample

    places = np.array([[400.0, 250.0, 250.0], [800.0, 500.0, 0.0], [0.0, 0.0, 500.0]])
    with serving(replay=True) as service:
        state, now_s = service.state, NOON
        assert state.thermal is not None
        before = state.compensate(places, None, now_s)
        for event, *values in events:
            if event == "sample":
                dt_s, readings, rpm = values
                names = dict(zip(("spindle", "column", "ambient"), readings, strict=True))
                state.take([Sample(time=now_s + dt_s, temperatures=names, channels={"spindle_rpm": rpm})])
            elif event == "datum":
                state.thermal.set_datum()
            elif event == "absolute":
                state.thermal.clear_datum()
            else:
                dt_s, tool_mm = values
                now_s += dt_s
                state.compensate(places, tool_mm, now_s)
                # Asked again with the machine's own tool, at the same moment: nothing moves in between.
                after = state.compensate(places, None, now_s)
                assert np.isfinite(after.correction_mm).all()
                assert np.abs(after.correction_mm).max() <= 0.3 * (1 + 1e-12)
                passed_s = after.outlook.now_s - before.outlook.now_s
                assert passed_s >= 0.0
                assert np.abs(after.correction_mm - before.correction_mm).max() <= 0.06 / 60.0 * passed_s + 2e-6
                before = after
        assert service.client.post(f"{TINY_URL}/compensate", json={"positions": [MIDDLE]}).status_code == 200


def test_a_sample_of_a_wrong_hour_is_refused_and_changes_nothing(service: Service) -> None:
    service.telemetry(sample(NOON, 25.0))
    answer = service.client.post(f"{TINY_URL}/telemetry", json={"samples": [sample(NOON + 3600.0, 25.0)]})
    assert_problem(answer, 422, "invalid-request", "key 'time' in samples[0] must not be more than 60 s ahead of")
    service.clock[0] += 60.0
    assert service.telemetry(sample(NOON + 60.0, 26.0))["accepted"] == 1


def test_times_in_requests_do_not_move_the_rate_limit_on_a_real_machine(service: Service) -> None:
    """However late a client says it is, the service's own seconds count."""
    service.compensate()
    service.warm(degC=30.0)
    for ahead in (0.0, 30.0, 59.0):
        served = correction_um(service.compensate(time=NOON + ahead))
        np.testing.assert_allclose(served, correction_um(service.compensate()), atol=1e-9)
    before = correction_um(service.compensate())
    service.clock[0] += 10.0
    assert 0.0 < np.abs(correction_um(service.compensate(time=NOON + 59.0)) - before).max() <= 10.0


def test_a_clock_set_forward_does_not_move_the_correction_at_once() -> None:
    """The rate goes by a clock that never jumps; only the age of telemetry goes by the wall clock."""
    wall, steady = [NOON], [5.0]
    app = create_app([load_bundle(TINY)], Settings(), clock=lambda: wall[0], steady=lambda: steady[0])
    with TestClient(app) as client:
        service = Service(client, wall)
        cold = correction_um(service.compensate())
        service.warm(degC=30.0)
        wall[0] += 300.0
        np.testing.assert_array_equal(correction_um(service.compensate()), cold)
        steady[0] += 1.0
        assert 0.0 < np.abs(correction_um(service.compensate()) - cold).max() <= 1.0


@pytest.mark.parametrize("rpm", [1e9, 1e100, -30000.0])
def test_a_channel_beyond_belief_is_not_used_and_leaves_no_trace(service: Service, rpm: float) -> None:
    with serving() as other:
        for running, value in ((service, rpm), (other, 0.0)):
            running.telemetry(sample(NOON - 7200.0, 25.0), sample(NOON - 3600.0, 25.0, rpm=value))
            running.telemetry(sample(NOON, 25.0))
        assert service.compensate()["points"] == other.compensate()["points"]
    reply = service.telemetry(sample(NOON + 1.0, 25.0, rpm=rpm))
    assert any(
        w.startswith(f"channel 'spindle_rpm' is {rpm:g}, beyond the plausible ±20000") for w in reply["warnings"]
    )


def test_a_channel_no_longer_given_is_held_for_a_while_and_then_taken_as_zero(service: Service) -> None:
    assert service.state.thermal is not None
    service.telemetry(sample(NOON - 3600.0, 25.0, rpm=5000.0))
    for t, expected in ((-3300.0, 5000.0), (-3000.0, 5000.0), (-2900.0, 0.0), (-2000.0, 0.0)):
        silent = {**sample(NOON + t, 25.0), "channels": {}}
        reply = service.telemetry(silent)
        assert service.state.thermal.state is not None
        assert service.state.thermal.state.inputs[-1] == expected
        assert reply["warnings"] == [f"channel 'spindle_rpm' has no value; taken as {expected:g}"]
    assert "degraded" in service.compensate()["status"] or service.compensate()["status"] == "stale"


def test_a_wrong_first_reading_does_not_spoil_the_start(service: Service) -> None:
    with serving() as clean:
        for running, first in ((service, 45.0), (clean, 20.0)):
            running.telemetry(
                sample(NOON - 1200.0, 20.0, column=first),
                *(sample(NOON - 1200.0 + 60.0 * i, 20.0) for i in range(1, 21)),
            )
        gap = correction_um(service.compensate()) - correction_um(clean.compensate())
    assert np.abs(gap).max() < 0.5
