"""Nothing is reported to anybody: onnxruntime's telemetry is off wherever it is used."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from service_client import TINY

LOAD = f"""
from model.bundle import load_bundle
from model.predictor import Predictor
Predictor(load_bundle({str(TINY)!r}))
"""


def traces(script: str, home: Path) -> list[str]:
    """Run a script with a home of its own, and return what onnxruntime has left there."""
    environment = {k: v for k, v in os.environ.items() if k != "ORT_DISABLE_TELEMETRY" and not k.startswith("XDG_")}
    subprocess.run(
        [sys.executable, "-c", script], check=True, env=environment | {"HOME": str(home)}, capture_output=True
    )
    return [str(path) for path in home.rglob("*onnxruntime*")]


def test_the_network_runs_without_telemetry(tmp_path: Path) -> None:
    assert traces(LOAD, tmp_path) == []


@pytest.mark.parametrize("module", ["model.predictor", "model.sessions", "training.job"])
def test_the_switch_is_set_before_onnxruntime_is_imported(module: str) -> None:
    watch = f"""
import os, sys
class Watch:
    def find_spec(self, name, path=None, target=None):
        if name == "onnxruntime":
            print("switch", os.environ.get("ORT_DISABLE_TELEMETRY"))
sys.meta_path.insert(0, Watch())
import {module}
"""
    environment = {k: v for k, v in os.environ.items() if k != "ORT_DISABLE_TELEMETRY"}
    done = subprocess.run([sys.executable, "-c", watch], check=True, env=environment, capture_output=True, text=True)
    assert "switch 1" in done.stdout
    assert "switch None" not in done.stdout
