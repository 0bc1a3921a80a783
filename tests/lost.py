"""The tiny bundle with statistics for lost sensors, without torch."""

import dataclasses
import shutil
from pathlib import Path

import numpy as np
from bundles import edit

from model.bundle import load_bundle
from model.manifest import LostSensorRecord
from model.predictor import Predictor, ThermalState
from model.telemetry import Run

TINY = Path(__file__).parent / "data" / "tiny_bundle"
SENSORS, MODES, SOURCES = 3, 2, 1
FEATURES = SENSORS * (1 + MODES) + SOURCES * MODES
TAU_S = np.array([300.0, 3600.0])
COLUMN = 1
"""The sensor that is lost."""


def telemetry(seed: int, told: bool) -> Run:
    """Return an irregular run; the column lies halfway between the others, or, not `told`, goes its own way."""
    rng = np.random.default_rng(seed)
    time_s = np.cumsum(rng.uniform(20.0, 300.0, 240))
    walk = 20.0 + np.cumsum(rng.normal(0.0, 0.4, (240, SENSORS)), axis=0)
    if told:
        walk[:, COLUMN] = 0.5 * (walk[:, 0] + walk[:, 2])
    speed = np.repeat(rng.choice([0.0, 5000.0, 10000.0], 24), 10)
    return Run("r", time_s, walk, speed[:, None])


def record_of(states: list[ThermalState], noise: float = 1e-9) -> LostSensorRecord:
    """Return the statistics of states, whose drives are temperatures less 20 °C."""
    rows = []
    for state in states:
        filtered = state.modes.reshape(SENSORS + SOURCES, MODES)
        degC = np.concatenate([state.inputs[:SENSORS, None], 20.0 + filtered[:SENSORS]], axis=1)
        rows.append(np.concatenate([degC.ravel(), filtered[SENSORS:].ravel()]))
    features = np.array(rows)
    mean = features.mean(axis=0)
    scaled = features - mean
    scaled[:, SENSORS * (1 + MODES) :] *= 2.0  # a source's size beside a swing
    values, vectors = np.linalg.eigh(scaled.T @ scaled / len(scaled))
    return LostSensorRecord(
        mean=mean.tolist(),
        swing_K=1.0,
        factors=(vectors * np.sqrt(np.maximum(values, 0.0))).T.tolist(),
        noise=noise,
        memory_s=[1800.0, 1800.0, 7200.0],
        scale=1.0,
        drift_um=20.0,
    )


def bundle_with(folder: Path, record: LostSensorRecord | None, datum: str = "absolute") -> Predictor:
    path = Path(shutil.copytree(TINY, folder / "bundle"))

    def change(manifest: dict[str, object]) -> None:
        network = manifest["network"]
        assert isinstance(network, dict)
        network["datum"] = datum
        network["lost_sensors"] = None if record is None else record.model_dump(mode="json")

    edit(path, change)
    return Predictor(load_bundle(path))


def untold_record() -> LostSensorRecord:
    plain = Predictor(load_bundle(TINY))
    return record_of(plain.states(telemetry(0, told=False)), noise=0.01)


def losing(run: Run, sensors: list[int], start: int = 0, stop: int | None = None) -> Run:
    temperatures = run.temperatures.copy()
    temperatures[start:stop, sensors] = np.nan
    return dataclasses.replace(run, temperatures=temperatures)
