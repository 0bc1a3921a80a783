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
BARE = f"""
import onnxruntime
onnxruntime.InferenceSession({str(TINY / "network.onnx")!r}, providers=["CPUExecutionProvider"])
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


def test_onnxruntime_alone_leaves_traces(tmp_path: Path) -> None:
    if not traces(BARE, tmp_path):
        pytest.skip("this build of onnxruntime has no telemetry")
