"""`compensate?explain=true`: why a deviation is what it is."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from machines import machine_text
from service_client import MIDDLE, NOON, TINY, TINY_URL, Service, assert_problem, sample, serving

from model.bundle import load_bundle, write_bundle
from model.chain import Chain
from model.error_map import ErrorMap
from model.machine import parse_machine
from service.explain import SMALLEST_UM, explain
from service.schemas import MAX_EXPLAINED_PER_REQUEST, Explanation

URL = f"{TINY_URL}/compensate"


def explained(service: Service, positions: list[dict[str, float]], **more: Any) -> list[dict[str, Any]]:
    answer = service.client.post(f"{URL}?explain=true", json={"positions": positions, **more})
    assert answer.status_code == 200, answer.text
    points: list[dict[str, Any]] = answer.json()["points"]
    return points


def xyz(vector: dict[str, float]) -> Any:
    return np.array([vector["x"], vector["y"], vector["z"]])


def added_up(explanation: dict[str, Any]) -> Any:
    shares = [*explanation["terms"], explanation["others"]]
    return sum(xyz(s["geometric_um"]) + xyz(s["thermal_um"]) for s in shares) + xyz(explanation["second_order_um"])


def test_shares_by_hand(service: Service) -> None:
    service.warm(degC=30.0)
    [point] = explained(service, [MIDDLE])
    shares = {t["term"]: t for t in point["explanation"]["terms"]}
    assert set(shares) == {"EXX", "EYX", "EZ0T"}  # EC0Y turns about where the tip stands
    # On the workpiece side the tip moves against the term. 10 K: EXX +40 µm at its middle, EZ0T -40 µm.
    assert shares["EXX"]["geometric_um"] == pytest.approx({"x": -6.0, "y": 0.0, "z": 0.0})
    assert shares["EXX"]["thermal_um"] == pytest.approx({"x": -40.0, "y": 0.0, "z": 0.0}, abs=0.05)
    assert shares["EYX"]["geometric_um"] == pytest.approx({"x": 0.0, "y": -3.0, "z": 0.0})
    assert shares["EYX"]["thermal_um"] == pytest.approx({"x": 0.0, "y": 0.0, "z": 0.0}, abs=1e-9)
    assert shares["EZ0T"]["thermal_um"] == pytest.approx({"x": 0.0, "y": 0.0, "z": -40.0}, abs=0.05)
    sizes = [np.linalg.norm(xyz(t["geometric_um"]) + xyz(t["thermal_um"])) for t in point["explanation"]["terms"]]
    assert sizes == sorted(sizes, reverse=True)
    assert np.linalg.norm(xyz(point["explanation"]["second_order_um"])) < 0.05


def test_it_changes_nothing_else(service: Service) -> None:
    service.warm(degC=30.0)
    plain = service.compensate([MIDDLE])
    assert "explanation" not in plain["points"][0]
    [point] = explained(service, [MIDDLE])
    assert {k: v for k, v in point.items() if k != "explanation"} == plain["points"][0]
    off = service.client.post(f"{URL}?explain=false", json={"positions": [MIDDLE]}).json()
    assert off == plain


def test_while_a_prediction_is_not_usable_what_is_served_is_explained(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    service.warm(degC=30.0)
    before = explained(service, [MIDDLE])
    broken = ErrorMap.zero(service.state.machine)
    broken.location[0] = float("nan")
    monkeypatch.setattr(service.state.thermal, "error_map", lambda: broken)
    after = explained(service, [MIDDLE])
    assert after[0]["explanation"]["terms"] == before[0]["explanation"]["terms"]
    np.testing.assert_allclose(added_up(after[0]["explanation"]), xyz(after[0]["deviation_um"]), atol=1e-9)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    degC=st.floats(16.0, 34.0),
    age_s=st.floats(0.0, 3000.0),
    length_mm=st.none() | st.floats(0.0, 400.0),
    places=st.lists(st.tuples(st.floats(0, 800), st.floats(0, 500), st.floats(0, 500)), min_size=1, max_size=5),
)
def test_shares_add_up_to_the_deviation(
    degC: float, age_s: float, length_mm: float | None, places: list[tuple[float, float, float]]
) -> None:
    with serving() as service:
        service.warm(degC=degC)
        service.clock[0] += age_s
        tool = {} if length_mm is None else {"tool": {"length_mm": length_mm}}
        points = explained(service, [dict(zip("XYZ", place, strict=True)) for place in places], **tool)
    for point in points:
        np.testing.assert_allclose(added_up(point["explanation"]), xyz(point["deviation_um"]), atol=1e-9)


@given(st.integers(0, 2**32 - 1), st.sampled_from(["motion-last", "seed"]))
@settings(max_examples=50, deadline=None)
def test_the_law_for_any_terms(seed: int, composition: str) -> None:
    """Shares add up; each is what the chain's first order gives for that term alone; what is left grows as a square."""
    machine = parse_machine(machine_text(composition=composition))
    chain = Chain(machine)
    rng = np.random.default_rng(seed)
    rows = [
        (t.name, None if t.kind == "location" else float(rng.uniform(0, 500)), float(rng.normal(0, 20)))
        for t in machine.terms
    ]
    geometric = ErrorMap.from_rows(machine, rows)
    thermal = ErrorMap.from_rows(machine, [(name, at, float(rng.normal(0, 20))) for name, at, _ in rows])
    q = rng.uniform(0.0, 250.0, (4, 3))
    seconds = []
    for factor in (1.0, 0.5):
        cold, whole = geometric.scaled(factor), (geometric + thermal).scaled(factor)
        e = whole.evaluate(q)
        deviation = chain.tip(q, e) - chain.tip(q)
        found = explain(chain, q, None, whole, cold, deviation)
        for point, told in enumerate(found):
            told_of = told.model_dump()
            np.testing.assert_allclose(added_up(told_of), 1000.0 * deviation[point], atol=1e-9)
            for share in told_of["terms"]:
                alone = np.zeros_like(e)
                k = machine.term_index[share["term"]]
                alone[:, k] = e[:, k] * 1e-3  # so small that the second order is nothing
                moved = (chain.tip(q, alone) - chain.tip(q))[point] * 1e6
                np.testing.assert_allclose(
                    xyz(share["geometric_um"]) + xyz(share["thermal_um"]), moved, rtol=1e-4, atol=1e-4
                )
                parts = [np.linalg.norm(xyz(share[p])) for p in ("geometric_um", "thermal_um")]
                assert max(parts) >= SMALLEST_UM
        seconds.append([xyz(told.model_dump()["second_order_um"]) for told in found])
    np.testing.assert_allclose(seconds[0], 4.0 * np.array(seconds[1]), rtol=2e-3, atol=1e-4)


def test_small_terms_are_summed_as_others(tmp_path: Path) -> None:
    machine = load_bundle(TINY).machine
    rows = [("EX0T", None, 5.0), ("EX0X", None, 0.0009), ("EY0X", None, 0.0004), ("EX0Y", None, 0.0005)]
    with serving(write_bundle(tmp_path / "small", machine, geometry=rows)) as service:
        [point] = explained(service, [MIDDLE])
    assert [t["term"] for t in point["explanation"]["terms"]] == ["EX0T"]
    assert point["explanation"]["others"]["geometric_um"] == pytest.approx({"x": -0.0014, "y": -0.0004, "z": 0.0})


def test_only_so_many_points_are_explained(service: Service) -> None:
    service.warm(degC=20.0, end=NOON - 60.0)
    many = [MIDDLE] * (MAX_EXPLAINED_PER_REQUEST + 1)
    answer = service.client.post(f"{URL}?explain=true", json={"positions": many, **sample(NOON, 24.0)})
    assert_problem(
        answer, 422, "invalid-request", "at most 100 positions can be explained in one request, got 101; send fewer"
    )
    assert service.state.thermal is not None
    assert service.state.thermal.state is not None
    assert service.state.thermal.state.time_s == NOON - 60.0
    assert len(explained(service, many[1:])) == MAX_EXPLAINED_PER_REQUEST
    assert len(service.compensate(many)["points"]) == MAX_EXPLAINED_PER_REQUEST + 1


@pytest.mark.parametrize(
    ("query", "detail"),
    [
        ("explain=maybe", "key 'explain' in the query: input should be a valid boolean"),
        ("explian=true", "unknown key 'explian' in the query; did you mean 'explain'?"),
    ],
)
def test_a_wrong_query_gets_one_sentence(service: Service, query: str, detail: str) -> None:
    answer = service.client.post(f"{URL}?{query}", json={"positions": [MIDDLE]})
    assert_problem(answer, 422, "invalid-request", detail)


def test_the_example_is_an_explanation(service: Service) -> None:
    described = service.client.get("/openapi.json").json()
    [example] = described["components"]["schemas"]["Explanation"]["examples"]
    assert Explanation.model_validate(example).model_dump() == example
