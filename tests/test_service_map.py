"""`/map`: a client that has nothing else compensates as the service does."""

import json
from pathlib import Path
from typing import Any

import map_client
import numpy as np
import pytest
from machines import machine_text
from service_client import MIDDLE, NOON, TINY_URL, Service, assert_problem, correction_um, sample, serving

from model.bundle import write_bundle
from model.error_map import ErrorMap
from model.machine import parse_machine
from service.map_schemas import MapReply

PLACES = [
    MIDDLE,
    {"X": 0.0, "Y": 0.0, "Z": 0.0},
    {"X": 800.0, "Y": 111.1, "Z": 499.0},
    {"X": 7.7, "Y": 240.0, "Z": 3.3},
]
NANOMETRE = 1e-6

TREE = (
    machine_text()
    .replace(
        'structure = "w X Y b Z t"',
        'bodies = [{name = "base"}, {name = "column", lower = "base"}, {name = "slide", lower = "column", axis = "Y"}, '
        '{name = "workpiece", lower = "slide"}, {name = "bridge", lower = "base", axis = "X"}, '
        '{name = "ram", lower = "bridge", axis = "Z"}, {name = "tool", lower = "ram"}]',
    )
    .replace("[axes.Z]", "[axes.Z]\ndirection = [0.0, 0.6, 0.8]")
)
MACHINES = {
    "motion-last": machine_text("w X Y b Z t"),
    "seed": machine_text("w Y b X Z t", "seed"),
    "all on the tool": machine_text("w b Z Y X t", errors=False),
    "a tree": TREE,
}


def agree(service: Service, positions: list[dict[str, float]] = PLACES, **tool: Any) -> dict[str, Any]:
    """Check the client against the service at this moment, and return the map."""
    length = tool.get("length_mm")
    answer = service.get("/map", **({} if length is None else {"tool_length_mm": length}))
    tip = None if length is None else length * np.array(answer["tool"]["direction"])
    reply = service.compensate(positions, **({"tool": tool} if tool else {}))
    theirs = np.array([[p["corrected"][a] for a in answer["axes"]] for p in reply["points"]])
    assert np.abs(map_client.compensate(answer, positions, tip) - theirs).max() <= NANOMETRE
    assert (answer["status"], answer["time"]) == (reply["status"], reply["time"])
    return answer


@pytest.mark.parametrize("name", MACHINES)
def test_a_client_alone_compensates_as_the_service_does(name: str, tmp_path: Path) -> None:
    machine = parse_machine(MACHINES[name].replace('name = "test"', 'name = "tiny"'))
    rng = np.random.default_rng(7)
    rows = []
    for term in machine.terms:
        size = 30.0 if term.kind == "motion" or not term.angular else 100.0
        places = [None] if term.kind == "location" else sorted(rng.uniform(-300.0, 800.0, rng.integers(1, 6)).tolist())
        rows += [(term.name, at, float(rng.uniform(-size, size))) for at in places]
    with serving(write_bundle(tmp_path / "machine", machine, geometry=rows)) as service:
        answer = agree(service)
        agree(service, length_mm=220.0)
    assert answer["composition"] == machine.composition
    assert answer["valid_until"] is None


def test_it_does_so_while_the_map_is_on_its_way(service: Service) -> None:
    service.warm(degC=30.0)
    at_rest = agree(service)
    assert at_rest["target"] is None
    assert at_rest["remaining_um"] == 0.0
    service.post("datum")
    service.clock[0] += 6.0
    moving = agree(service)
    assert moving["remaining_um"] > 1.0
    assert moving["warnings"][-1].startswith("the correction is up to ")
    # What it moves to is what /errors shows.
    total = {t["term"]: t["total"] for t in service.get("/errors")["terms"]}
    for table in ("motion_um", "motion_urad"):
        for term, values in moving["target"][table].items():
            assert values == pytest.approx(total[term], abs=1e-9)
    for table in ("location_um", "location_urad"):
        assert moving["target"][table] == pytest.approx({t: total[t][0] for t in moving["target"][table]}, abs=1e-9)
    assert moving["served"] != moving["target"]
    service.clock[0] += 300.0
    arrived = agree(service, length_mm=300.0)
    assert arrived["target"] is None
    assert arrived["datum"]["kind"] == "set"


def test_the_absolute_limit_is_the_clients_too(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    assert service.state.thermal is not None
    far = ErrorMap.from_rows(service.state.machine, [("EX0X", None, 500.0)])
    monkeypatch.setattr(service.state.thermal.predictor, "error_map", lambda state: far)
    service.telemetry(sample(NOON))
    agree(service)


def test_a_map_counts_as_served_so_that_the_rate_limit_holds_from_one_to_the_next(service: Service) -> None:
    def correction(answer: dict[str, Any]) -> Any:
        return 1000.0 * (map_client.compensate(answer, [MIDDLE]) - [list(MIDDLE.values())])

    before = correction(service.get("/map"))
    service.warm(degC=30.0)
    for _ in range(10):
        service.clock[0] += 6.0
        after = correction(service.get("/map"))
        assert 1.0 < np.abs(after - before).max() <= 6.0  # 60 µm/min
        before = after
    np.testing.assert_allclose(correction_um(service.compensate()), before, atol=1e-3)


def test_a_longer_tool_slows_the_map_down(service: Service) -> None:
    service.get("/map")
    service.warm(degC=30.0)
    service.clock[0] += 6.0
    service.get("/map", tool_length_mm=2000.0)
    assert service.state._reach.longest_mm == 2000.0


def test_the_etag_names_the_map_until_anything_in_it_changes(service: Service) -> None:
    service.warm(degC=25.0)
    first = service.client.get(f"{TINY_URL}/map")
    tag = first.headers["etag"]
    assert tag == f'W/"{first.json()["version"]}"'
    assert first.headers["cache-control"] == "private, no-cache"
    service.clock[0] += 20.0
    for known in (tag, f'"other", {tag}', tag.removeprefix("W/"), "*"):
        answer = service.client.get(f"{TINY_URL}/map", headers={"if-none-match": known})
        assert (answer.status_code, answer.content, answer.headers["etag"]) == (304, b"", tag)
        assert answer.headers["cache-control"] == "private, no-cache"
    for unknown in ('W/"other"', first.json()["version"], "", '"'):
        answer = service.client.get(f"{TINY_URL}/map", headers={"if-none-match": unknown})
        assert answer.status_code == 200
        assert answer.headers["etag"] == tag
    seen = {tag}
    changes = [
        lambda: service.telemetry(sample(service.clock[0], 25.0)),  # valid for longer
        lambda: service.telemetry(sample(service.clock[0] + 1.0, 25.5)),
        lambda: service.telemetry(sample(service.clock[0] + 2.0, 25.5, column=None)),  # degraded
        lambda: service.post("datum"),
        lambda: service.clock.__setitem__(0, service.clock[0] + 700.0),  # stale
    ]
    for change in changes:
        change()
        answer = service.client.get(f"{TINY_URL}/map", headers={"if-none-match": tag})
        assert answer.status_code == 200
        tag = answer.headers["etag"]
        assert tag not in seen
        seen.add(tag)


def test_how_long_it_may_be_used(service: Service) -> None:
    assert service.get("/map")["valid_until"] is None
    service.telemetry(sample(NOON - 60.0))
    assert service.get("/map")["valid_until"] == "2027-01-15T08:09:00Z"  # stale after ten minutes
    with serving(stale_after_s=1e300) as patient:
        patient.telemetry(sample(NOON))
        assert patient.get("/map")["valid_until"] == "9999-12-31T23:59:59Z"


def test_an_unusable_prediction_holds_the_map(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    service.warm(degC=25.0)
    before = service.get("/map")
    broken = ErrorMap.zero(service.state.machine)
    broken.location[0] = float("nan")
    monkeypatch.setattr(service.state.thermal, "error_map", lambda: broken)
    held = agree(service)
    assert held["served"] == before["served"]
    assert (held["status"], held["target"]) == ("degraded", None)
    assert held["version"] != before["version"]


def test_its_clock_is_the_querys_in_replay_alone(replayed: Service, service: Service) -> None:
    assert replayed.get("/map", time=NOON + 30.0)["time"] == "2027-01-15T08:00:30Z"
    assert service.get("/map", time=NOON + 30.0)["time"] == "2027-01-15T08:00:00Z"


@pytest.mark.parametrize(
    ("query", "detail"),
    [
        ("tool_length_mm=-1", "key 'tool_length_mm' in the query: input should be greater"),
        ("tool_length_mm=2001", "key 'tool_length_mm' in the query: input should be less"),
        ("tool_length_mm=nan", "key 'tool_length_mm' in the query: input should be"),
        ("tool_lenght_mm=1", "unknown key 'tool_lenght_mm' in the query; did you mean 'tool_length_mm'?"),
        ("time=tomorrow", "key 'time' in the query: must be RFC 3339"),
        (f"time={NOON + 1e6}", "key 'time' in the query must not be more than 60 s ahead"),
    ],
)
def test_a_wrong_query_gets_one_sentence_and_serves_nothing(service: Service, query: str, detail: str) -> None:
    assert_problem(service.client.get(f"{TINY_URL}/map?{query}"), 422, "invalid-request", detail)
    assert service.state.served is None


def test_the_example_is_a_map_that_a_client_can_use(service: Service) -> None:
    described = service.client.get("/openapi.json").json()
    [example] = described["components"]["schemas"]["MapReply"]["examples"]
    assert json.loads(MapReply.model_validate(example).model_dump_json(exclude_none=True)) == example
    terms = {t for body in example["structure"] for t in body["motion_terms"] + body["location_terms"]}
    tables = example["served"]
    assert terms == {t for name, table in tables.items() if name != "knots_mm" for t in table}
    assert set(tables["knots_mm"]) == set(example["axes"])
    responses = described["paths"]["/v1/machines/{name}/map"]["get"]["responses"]
    assert {"200", "304", "default"} <= set(responses)
