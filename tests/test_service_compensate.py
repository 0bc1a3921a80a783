import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from service_client import MIDDLE, NOON, TINY, Service, correction_um, sample, serving

from model.bundle import load_bundle, write_bundle
from model.error_map import ErrorMap

HOUR = 3600.0
CORNERS = [{"X": x, "Y": y, "Z": z} for x in (0.0, 800.0) for y in (0.0, 500.0) for z in (0.0, 499.0)]


def test_without_telemetry_only_the_geometric_errors_are_corrected(service: Service) -> None:
    reply = service.compensate()
    assert reply["status"] == "geometric_only"
    assert reply["model"] == service.state.bundle.version
    assert reply["time"] == "2027-01-15T08:00:00Z"
    assert reply["warnings"][0].startswith("no telemetry has come yet")
    # By hand: EXX is 6 µm and EYX 3 µm at X = 400, on the workpiece side, so the tip is that much short. EC0Y turns
    # table and workpiece about the bed's origin, over which the tip stands.
    [point] = reply["points"]
    assert point["deviation_um"]["x"] == pytest.approx(-6.0, abs=0.05)
    assert point["deviation_um"]["y"] == pytest.approx(-3.0, abs=0.05)
    assert point["correction"]["X"] == pytest.approx(0.006, abs=5e-5)
    assert point["corrected"]["X"] == 400.0 + point["correction"]["X"]
    assert not point["limited"]


def test_warmth_changes_the_correction_by_what_the_network_says(service: Service) -> None:
    service.warm(degC=30.0)
    thermal = service.compensate()
    with serving() as cold:
        geometric = cold.compensate()
    change = correction_um(thermal) - correction_um(geometric)
    # 10 K: EXX +80 µm over the axis, so +40 at its middle; EZ0T -40 µm: the tool grows, so Z must go up.
    np.testing.assert_allclose(change, [[40.0, 0.0, 40.0]], atol=0.05)
    assert thermal["status"] == "ok"
    assert thermal["warnings"] == []


def test_an_hour_of_telemetry_moves_the_correction_at_its_rate(replayed: Service) -> None:
    before = correction_um(replayed.compensate())
    replayed.telemetry(*(sample(NOON + 10.0 * i, 20.0 + 0.03 * i) for i in range(361)))
    reply = replayed.compensate(time=NOON + 6.0)
    moved = np.abs(correction_um(reply) - before).max()
    assert 0.0 < moved <= 6.0  # 60 µm/min for six seconds
    assert reply["points"][0]["limited"]
    assert any(w.startswith("the correction is up to ") for w in reply["warnings"])
    replayed.clock[0] = NOON + HOUR
    reply = replayed.compensate()
    assert not reply["points"][0]["limited"]
    assert np.abs(correction_um(reply) - before).max() > 10.0


def test_corrected_coordinates_put_the_exact_chain_at_the_ideal_tip(service: Service) -> None:
    """With nothing but what the interface says: corrected coordinates, and the error terms there."""
    service.telemetry(*(sample(NOON - 60.0 * i, 24.0 + 0.01 * i, rpm=3000.0) for i in range(300)))
    positions = [MIDDLE, *CORNERS]
    for tool, tool_mm in ((None, None), ({"length_mm": 180.0}, np.array([0.0, 0.0, -180.0]))):
        reply = service.compensate(positions, tool=tool)
        assert not any(p["limited"] for p in reply["points"])
        corrected = [p["corrected"] for p in reply["points"]]
        answer = service.get("/errors", **{axis: [c[axis] for c in corrected] for axis in "XYZ"})
        machine, chain = service.state.machine, service.state.chain
        e = np.zeros((len(corrected), len(machine.terms)))
        for term in answer["terms"]:
            known = machine.term(term["term"])
            e[:, machine.term_index[known.name]] = np.array(term["total"]) * known.to_internal
        q = np.array([[c[a] for a in "XYZ"] for c in corrected])
        programmed = np.array([[p[a] for a in "XYZ"] for p in positions])
        miss = chain.tip(q, e, tool_mm) - chain.tip(programmed, None, tool_mm)
        assert np.linalg.norm(miss, axis=1).max() <= 1e-6


def test_errors_on_the_grid_are_the_map(service: Service) -> None:
    service.warm(degC=25.0)
    answer = service.get("/errors")
    assert answer["reliability"] == 1.0
    machine = service.state.machine
    rows = [
        (t["term"], at, value)
        for t in answer["terms"]
        for at, value in zip(t["at_mm"] or [None], t["total"], strict=True)
    ]
    q = np.random.default_rng(0).uniform(0.0, 500.0, (20, 3))
    found = ErrorMap.from_rows(machine, rows).evaluate(q)
    target = service.state.outlook(service.clock[0]).target.errors
    np.testing.assert_allclose(found, target.evaluate(q), atol=1e-12)
    by_name = {t["term"]: t for t in answer["terms"]}
    exx = by_name["EXX"]
    assert (exx["unit"], exx["axis"], exx["at_mm"][0], exx["at_mm"][-1]) == ("um", "X", 0.0, 800.0)
    assert exx["thermal"][-1] == pytest.approx(40.0, rel=1e-3)
    assert exx["geometric"][-1] == pytest.approx(12.0)
    assert by_name["EC0Y"]["at_mm"] is None
    assert by_name["EC0Y"]["total"] == pytest.approx([-20.0 + 10.0], rel=1e-3)


def test_temperatures_in_the_request_count_as_a_sample_first(service: Service) -> None:
    service.warm(degC=20.0, end=NOON - 60.0)
    with_sample = service.compensate(time=NOON, temperatures=sample(0, 24.0)["temperatures"], channels={})
    state = service.state.thermal
    assert state is not None
    assert state.state is not None
    assert state.state.time_s == NOON
    assert with_sample["status"] == "degraded"  # the channel was left out
    assert with_sample["warnings"][0] == "channel 'spindle_rpm' has no value; taken as 0"
    again = service.compensate(time=NOON, temperatures=sample(0, 24.0)["temperatures"])
    assert again["warnings"][0].startswith("1 of 1 samples are no newer than the thermal state")


def test_a_wrong_position_takes_no_sample_and_computes_nothing(service: Service) -> None:
    service.warm(degC=20.0, end=NOON - 60.0)
    body = {"positions": [MIDDLE, MIDDLE | {"Z": 501.0}], **sample(NOON, 40.0)}
    assert service.client.post("/v1/machines/tiny/compensate", json=body).status_code == 422
    assert service.state.thermal is not None
    assert service.state.thermal.state is not None
    assert service.state.thermal.state.time_s == NOON - 60.0
    assert service.state.served is None


def test_the_tool_length_is_the_lever_of_a_tilt(tmp_path: Path) -> None:
    """10 µrad about Y move the tip of a tool that is 200 mm longer, and points down, by 2 µm more in -X."""
    tilted = write_bundle(tmp_path / "tilted", load_bundle(TINY).machine, geometry=[("EB0Z", None, 10.0)])
    with serving(tilted) as service:
        replies = [service.compensate(tool={"length_mm": length}) for length in (50.0, 250.0)]
        own, same = service.compensate(), service.compensate(tool={"length_mm": 100.0})
    (short,), (long,) = (reply["points"] for reply in replies)
    assert long["deviation_um"]["x"] - short["deviation_um"]["x"] == pytest.approx(-2.0, abs=1e-3)
    assert correction_um(replies[1])[0, 0] - correction_um(replies[0])[0, 0] == pytest.approx(2.0, abs=1e-3)
    assert own == same  # the machine description's tool is 100 mm long


def test_the_clock_does_not_go_back(replayed: Service) -> None:
    assert replayed.compensate(time=NOON + 600.0)["time"] == "2027-01-15T08:10:00Z"
    assert replayed.compensate(time=NOON)["time"] == "2027-01-15T08:10:00Z"
    assert replayed.compensate()["time"] == "2027-01-15T08:10:00Z"
    assert replayed.compensate(time="2027-01-15T09:11:00+01:00")["time"] == "2027-01-15T08:11:00Z"


def test_a_correction_beyond_the_absolute_limit_is_clipped_and_says_so(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    thermal = service.state.thermal
    assert thermal is not None
    far = ErrorMap.from_rows(service.state.machine, [("EX0X", None, 500.0)])
    monkeypatch.setattr(thermal.predictor, "error_map", lambda state: far)
    service.telemetry(sample(NOON))
    reply = service.compensate()
    assert abs(reply["points"][0]["correction"]["X"]) == pytest.approx(0.3)
    assert abs(reply["points"][0]["deviation_um"]["x"]) > 400.0  # what is predicted is not limited
    assert reply["points"][0]["limited"]
    assert "1 positions are limited to ±300 µm on an axis" in reply["warnings"]


def test_a_corrected_position_that_leaves_its_axis_is_reported(service: Service) -> None:
    reply = service.compensate([MIDDLE | {"X": 800.0}])
    assert reply["points"][0]["corrected"]["X"] > 800.0
    assert "1 corrected positions leave the range 0 ... 800 mm of axis 'X'" in reply["warnings"]


@pytest.mark.parametrize(("age_s", "status"), [(0.0, "ok"), (599.0, "ok"), (700.0, "stale"), (1e5, "stale")])
def test_old_telemetry_fades_out_and_says_so(service: Service, age_s: float, status: str) -> None:
    service.warm(degC=30.0)
    service.clock[0] += age_s
    reply = service.compensate()
    assert reply["status"] == status
    weight = min(max(1.0 - (age_s - 600.0) / 1800.0, 0.0), 1.0)
    assert correction_um(reply)[0, 2] == pytest.approx(40.0 * weight, abs=0.05)
    if age_s == 1e5:
        assert reply["warnings"][0].endswith("the thermal part counts 0%")


def test_an_unusable_prediction_leaves_the_last_correction(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    service.warm(degC=25.0)
    before = correction_um(service.compensate())
    thermal = service.state.thermal
    assert thermal is not None
    broken = ErrorMap.zero(service.state.machine)
    broken.location[0] = math.nan
    with monkeypatch.context() as patch:
        step = thermal.predictor.step
        patch.setattr(thermal.predictor, "step", lambda *a: replace(step(*a), coefficients=np.full(4, 1e12)))
        assert service.telemetry(sample(NOON + 30.0, 25.0))["ignored"] == 1
        told = "the newest sample was not used: the error terms predicted from it are beyond any machine's"
        reply = service.compensate()
        assert (reply["status"], reply["warnings"]) == ("degraded", [told])
        np.testing.assert_allclose(correction_um(reply), before, atol=1e-6)
    service.telemetry(sample(NOON + 60.0, 25.0))
    monkeypatch.setattr(thermal, "error_map", lambda: broken)
    service.clock[0] += 60.0
    before = correction_um(service.compensate())
    reply = service.compensate()
    np.testing.assert_array_equal(correction_um(reply), before)
    assert reply["status"] == "degraded"
    assert reply["points"][0]["limited"]
    assert reply["warnings"] == ["the predicted error terms are not usable numbers, so the last correction is held"]
