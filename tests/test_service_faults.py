"""A shift of a synthetic machine with each sensor fault: the service never does more harm than doing nothing."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from data_synth.faults import KINDS, Fault
from model.bundle import load_bundle
from service.settings import Settings

ROOT = Path(__file__).parent.parent
HOURS = 10.0


def bench() -> ModuleType:
    """The script that plays whole weeks, as a module."""
    spec = importlib.util.spec_from_file_location("fault_week", ROOT / "bench" / "fault_week.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["fault_week"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def week() -> Any:
    return bench().Week.simulated(load_bundle(ROOT / "demo" / "vmc3"), 1003, HOURS)


@pytest.fixture(scope="module")
def healthy(week: Any) -> Any:
    return week.played((), Settings(replay=True), datum=True)


def worst(week: Any, kind: str, sensor: str) -> tuple[Fault, ...]:
    found: tuple[Fault, ...] = next(iter(bench().worst(week, kind, sensor)))
    return found


def test_a_healthy_machine_is_compensated_and_its_sensors_believed(healthy: Any) -> None:
    assert healthy.figures()[3] < 0.35 * healthy.figures()[1]
    assert healthy.missed[1] < 0.01


@pytest.mark.parametrize(("kind", "sensor"), [*((kind, "bed") for kind in KINDS), ("stuck", "spindle_front")])
def test_no_fault_does_more_harm_than_no_compensation(week: Any, healthy: Any, kind: str, sensor: str) -> None:
    faults = worst(week, kind, sensor)
    played = week.played(faults, Settings(replay=True), datum=True)
    assert played.hit.any()
    assert played.ratio <= 1.1
    if kind == "spike":
        np.testing.assert_allclose(played.figures()[3], healthy.figures()[3], rtol=0.1)
    if kind == "dropout":
        assert played.missed == (0.0, pytest.approx(healthy.missed[1], abs=0.01))


def test_a_large_offset_of_a_sensor_that_matters_is_not_believed(week: Any) -> None:
    played = week.played(worst(week, "offset", "bed"), Settings(replay=True), datum=True)
    assert played.missed[0] < 0.05
    assert played.figures()[3] < 0.6 * played.figures()[1]


def test_the_rig_measures_what_is_left(week: Any) -> None:
    """Without its sensors the thermal part is not applied, so all of the deviation is left."""
    run = week.run
    lost = tuple(Fault(run.name, s, "dropout", 0.0, float(run.time_s[-1])) for s in list(run.sensors)[1:])
    played = week.played(lost, Settings(replay=True), datum=False)
    assert (played.weight == 0.0).all()
    np.testing.assert_allclose(played.left_um, played.without_um, atol=1e-6)
