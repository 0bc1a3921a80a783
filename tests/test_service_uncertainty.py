"""How far a prediction may be off, as each point of a reply says: against the bundle's own record."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from machines import ARRANGEMENTS, machine_text
from service_client import MIDDLE, TINY_URL, Service, correction_um, sample, serving
from uncertain_bundle import uncertain_bundle

from model.bundle import load_bundle
from model.chain import Chain
from model.fields import Fields
from model.machine import Machine, parse_machine
from model.manifest import UncertaintyRecord
from model.uncertainty import NORMAL_95, Uncertainty
from service.uncertainty import Interval, relative_spread, unapplied_um

POSITIONS = [MIDDLE, {"X": 10.0, "Y": 480.0, "Z": 30.0}]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return uncertain_bundle(tmp_path_factory.mktemp("bundle"))


@pytest.fixture
def known(folder: Path) -> Iterator[Service]:
    """The tiny machine with a record of how far its predictions may be off."""
    with serving(load_bundle(folder)) as running:
        yield running


def made_up(machine: Machine, degree: int, seed: int) -> Uncertainty:
    """A record with random directions of all terms, whose series fall off as those of machines do."""
    rng = np.random.default_rng(seed)
    fields = Fields(machine, tuple(t.name for t in machine.terms), degree)
    widths = zip(fields.terms, fields.widths(), strict=True)
    angular = np.concatenate([np.full(w, machine.term(t).angular) for t, w in widths])
    falling = np.concatenate([0.3 ** np.arange(float(w)) for w in fields.widths()])
    directions = rng.normal(0.0, 1.0, (4, fields.size)) * np.where(angular, 5.0, 2.0) * falling
    record = UncertaintyRecord(
        directions=directions.tolist(), mode_size=[1.0], seen_directions=[[1.0]], floor=1.0, rise=0.0,
        misfit_um=0.5, scale=1.0, quantile=1.96, parts=2, independent=10.0, data="made up",
    )  # fmt: skip
    return Uncertainty(fields, record, 1)


def places(machine: Machine, count: int, seed: int = 0) -> np.ndarray[Any, np.dtype[np.float64]]:
    axes = [machine.axes[a] for a in machine.axis_names]
    return np.random.default_rng(seed).uniform([a.low for a in axes], [a.high for a in axes], (count, len(axes)))


def exactly(
    uncertainty: Uncertainty, machine: Machine, q: np.ndarray[Any, Any], length: float | None, spread: float
) -> np.ndarray[Any, Any]:
    tool_mm = None if length is None else length * np.asarray(machine.tool.direction)
    wanted: np.ndarray[Any, Any] = NORMAL_95 * uncertainty.whole(
        uncertainty.usual_tip(q, tool_mm), np.full(len(q), spread)
    ).max(axis=1)
    return wanted


@pytest.mark.parametrize("structure", ARRANGEMENTS[::5])
@pytest.mark.parametrize("length", [None, 0.0, 80.0, 412.0])
def test_between_nodes_it_is_the_record_of_the_bundle(structure: str, length: float | None) -> None:
    machine = parse_machine(machine_text(structure))
    uncertainty = made_up(machine, 3, 1)
    q = places(machine, 300)
    found = Interval(uncertainty, Chain(machine)).half_width_um(q, length, 1.7)
    wanted = exactly(uncertainty, machine, q, length, 1.7)
    assert (found >= 0.95 * wanted).all()
    assert (found <= 1.25 * wanted).all()
    assert np.median(found / wanted) == pytest.approx(1.03, abs=0.03)


@pytest.mark.parametrize("structure", ARRANGEMENTS)
def test_it_is_never_too_narrow_where_deviations_are_linear_in_position(structure: str) -> None:
    """Constant terms: their levers are affine in each coordinate, so the variance is convex along each axis."""
    machine = parse_machine(machine_text(structure))
    uncertainty = made_up(machine, 0, 2)
    q = places(machine, 500)
    for length in (None, 200.0):
        found = Interval(uncertainty, Chain(machine)).half_width_um(q, length, 0.8)
        assert (found >= exactly(uncertainty, machine, q, length, 0.8) * (1.0 - 1e-9)).all()


def test_the_demo_machine_is_met_within_some_percent() -> None:
    bundle = load_bundle(Path(__file__).parent.parent / "demo" / "vmc3")
    record = bundle.manifest.network
    assert record is not None
    assert record.uncertainty is not None
    uncertainty = Uncertainty(
        Fields(bundle.machine, tuple(record.terms), record.degree), record.uncertainty, record.modes
    )
    q = places(bundle.machine, 500)
    for length in (None, 60.0, 300.0):
        ratio = Interval(uncertainty, Chain(bundle.machine)).half_width_um(q, length, 1.0) / exactly(
            uncertainty, bundle.machine, q, length, 1.0
        )
        assert ratio.min() > 0.99
        assert ratio.max() < 1.1


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-1e4, 1e4)] * 3), min_size=1, max_size=20),
    st.none() | st.floats(0.0, 2000.0),
    st.floats(0.0, 1e6),
)
def test_one_position_is_the_same_as_many_and_always_a_number(
    rows: list[Any], length: float | None, spread: float
) -> None:
    q = np.array(rows)
    found = INTERVAL.half_width_um(q, length, spread)
    assert np.isfinite(found).all()
    assert (found >= NORMAL_95 * 0.5 * (1.0 - 1e-12)).all()
    each = [INTERVAL.half_width_um(row[None], length, spread)[0] for row in q]
    np.testing.assert_allclose(found, each, rtol=1e-12)
    many = INTERVAL.half_width_um(np.repeat(q, 10, axis=0), length, spread)
    np.testing.assert_allclose(many, np.repeat(found, 10), rtol=1e-12)


MACHINE = parse_machine(machine_text("w X Y b Z t"))
INTERVAL = Interval(made_up(MACHINE, 3, 3), Chain(MACHINE))


@given(st.floats(0.0, 10.0), st.floats(0.0, 10.0), st.floats(0.0, 10.0))
def test_it_grows_with_the_spread_and_with_the_datums(a: float, b: float, datum: float) -> None:
    q = np.array([[100.0, 100.0, 100.0]])
    low, high = sorted([a, b])
    assert INTERVAL.half_width_um(q, None, low) <= INTERVAL.half_width_um(q, None, high)
    assert relative_spread(low, datum) >= max(low, datum) * (1.0 - 1e-12)


def point(service: Service, **more: Any) -> dict[str, Any]:
    found: dict[str, Any] = service.compensate(POSITIONS, **more)["points"][1]
    return found


def test_a_reply_says_what_the_bundles_record_says(known: Service) -> None:
    known.warm(24.0)
    thermal = known.state.thermal
    assert thermal is not None
    assert thermal.state is not None
    uncertainty = thermal.predictor.uncertainty
    assert uncertainty is not None
    size = float(uncertainty.size(thermal.state.modes))
    reply = known.compensate(POSITIONS, tool={"length_mm": 150.0})
    assert reply["reliability"] == 1.0
    q = np.array([[p[a] for a in "XYZ"] for p in POSITIONS])
    wanted = exactly(uncertainty, known.state.machine, q, 150.0, size)
    np.testing.assert_allclose([p["uncertainty_um"] for p in reply["points"]], wanted, rtol=0.05)


def test_a_bundle_without_a_record_leaves_it_out(service: Service) -> None:
    service.warm()
    reply = service.compensate()
    assert "uncertainty_um" not in reply["points"][0]
    assert reply["reliability"] == 1.0


def test_before_telemetry_and_once_it_does_not_count_it_is_left_out(known: Service) -> None:
    assert "uncertainty_um" not in point(known)
    known.warm(24.0)
    assert "uncertainty_um" in point(known)
    known.clock[0] += 10 * 3600.0
    reply = known.compensate(POSITIONS)
    assert reply["reliability"] == 0.0
    assert "uncertainty_um" not in reply["points"][1]


def test_what_the_weight_leaves_out_of_the_prediction_is_added(known: Service) -> None:
    known.warm(24.0)
    whole = known.compensate(POSITIONS)["points"]
    known.clock[0] += known.state.settings.stale_after_s + known.state.settings.stale_fade_s / 4.0
    faded = known.compensate(POSITIONS)
    assert faded["reliability"] == pytest.approx(0.75)
    for before, after in zip(whole, faded["points"], strict=True):
        lost = max(abs(before["deviation_um"][k] - after["deviation_um"][k]) for k in "xyz")
        assert lost > 1.0
        assert after["uncertainty_um"] == pytest.approx(before["uncertainty_um"] + lost, abs=0.01)


def test_a_datum_adds_its_own_uncertainty(known: Service) -> None:
    known.warm(24.0)
    absolute = point(known)["uncertainty_um"]
    known.post("datum")
    relative = point(known)["uncertainty_um"]
    assert absolute < relative <= absolute * np.sqrt(2.0) * (1.0 + 1e-9)
    assert known.client.delete(f"{TINY_URL}/datum").status_code == 200
    assert point(known)["uncertainty_um"] == pytest.approx(absolute)


EVENTS = st.lists(
    st.tuples(
        st.sampled_from(["sample", "lost", "datum", "clear", "wait"]),
        st.floats(-50.0, 150.0),
        st.sampled_from([0.1, 60.0, 700.0, 4000.0]),
    ),
    min_size=1,
    max_size=8,
)


@settings(max_examples=8, deadline=None)
@given(EVENTS)
def test_whatever_happens_every_number_is_one_and_reliability_is_a_share(folder: Path, events: list[Any]) -> None:
    with serving(load_bundle(folder)) as running:
        for what, degC, wait_s in events:
            running.clock[0] += wait_s
            if what == "sample":
                running.telemetry(sample(running.clock[0], degC))
            elif what == "lost":
                running.telemetry(sample(running.clock[0], 22.0, spindle=None, column=degC))
            elif what == "datum":
                running.client.post(f"{TINY_URL}/datum")
            elif what == "clear":
                running.client.delete(f"{TINY_URL}/datum")
            reply = running.compensate(POSITIONS)
            assert np.isfinite(correction_um(reply)).all()
            assert 0.0 <= reply["reliability"] <= 1.0
            for one in reply["points"]:
                assert ("uncertainty_um" in one) == (reply["reliability"] > 0.0)
                assert np.isfinite(one.get("uncertainty_um", 0.0))
                assert one.get("uncertainty_um", 1.0) > 0.0


def test_the_part_left_out_vanishes_with_full_weight() -> None:
    bundle = load_bundle(Path(__file__).parent / "data" / "tiny_bundle")
    chain = Chain(bundle.machine)
    q = places(bundle.machine, 5)
    assert (unapplied_um(chain, q, bundle.geometry, 1.0, None) == 0.0).all()
    whole = unapplied_um(chain, q, bundle.geometry, 0.0, None)
    tip_um = (chain.tip(q, bundle.geometry.evaluate(q)) - chain.tip(q, None)) * 1e3
    np.testing.assert_allclose(whole, np.abs(tip_um).max(axis=1), atol=0.001)
