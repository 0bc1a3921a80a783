"""The service runs where torch and the offline packages cannot be imported."""

import subprocess
import sys

from service_client import TINY

SCRIPT = """
import asyncio, json, sys
# None makes an import fail; that a module is absent from sys.modules would prove less.
for name in ("torch", "pandas", "pyarrow", "onnx", "onnxscript", "scipy", "matplotlib", "training", "data_synth"):
    sys.modules[name] = None

import service.cli, service.listen
from model.bundle import load_bundle
from service.app import create_app
from service.settings import Settings

app = create_app([load_bundle(sys.argv[1])], Settings())
body = json.dumps({"positions": [{"X": 1.0, "Y": 2.0, "Z": 3.0}],
                   "temperatures": {"spindle": 22.0, "column": 21.0, "ambient": 20.0}}).encode()
scope = {"type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": "POST", "scheme": "http",
         "path": "/v1/machines/tiny/compensate", "raw_path": b"", "query_string": b"", "root_path": "",
         "headers": [(b"content-type", b"application/json")]}
sent = []

async def receive():
    return {"type": "http.request", "body": body, "more_body": False}

async def send(message):
    sent.append(message)

async def main():
    async with app.router.lifespan_context(app):
        await app(scope, receive, send)

asyncio.run(main())
assert sent[0]["status"] == 200, sent
print(sent[1]["body"].decode())
"""


def test_a_correction_needs_no_torch() -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", SCRIPT, str(TINY)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert '"status":"degraded"' in done.stdout  # the channel was left out
