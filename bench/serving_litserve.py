"""LitServe with the same ONNX network, on the same request: positions in, the network run once, corrections out.

What it is given for free: the thermal state is that of one sample, and nothing is checked, limited, stored or counted.
"""

import sys
from typing import Any

import litserve
import numpy as np

from model.bundle import load_bundle
from model.chain import Chain
from model.compensation import compensate
from model.predictor import Predictor

AXES = ("X", "Y", "Z")


class Corrections(litserve.LitAPI):
    """Predicts the error terms with the network, and compensates with them."""

    def __init__(self, bundle: str) -> None:
        super().__init__()
        self._path = bundle

    def setup(self, device: str) -> None:
        """Load the network; LitServe calls it in its worker."""
        bundle = load_bundle(self._path)
        self._predictor, self._geometry, self._chain = Predictor(bundle), bundle.geometry, Chain(bundle.machine)
        self._temperatures = np.full(len(self._predictor.sensors), 25.0)
        self._channels = np.zeros(len(self._predictor.channels))
        self._state = self._predictor.start(0.0, self._temperatures, self._channels)

    def decode_request(self, request: dict[str, Any]) -> Any:
        """Return the positions as an array."""
        return np.array([[position[axis] for axis in AXES] for position in request["positions"]])

    def predict(self, q: Any) -> Any:
        """Return the corrected coordinates."""
        self._state = self._predictor.step(self._state, self._state.time_s + 1.0, self._temperatures, self._channels)
        errors = self._geometry + self._predictor.error_map(self._state)
        return compensate(self._chain, q, errors).corrected

    def encode_response(self, corrected: Any) -> dict[str, Any]:
        """Return them by axis."""
        return {"points": [{"corrected": dict(zip(AXES, row, strict=True))} for row in corrected.tolist()]}


if __name__ == "__main__":
    bundle, port = sys.argv[1], int(sys.argv[sys.argv.index("--port") + 1])
    server = litserve.LitServer(Corrections(bundle), accelerator="cpu", healthcheck_path="/readyz")
    server.run(host="127.0.0.1", port=port, num_api_servers=1, log_level="error", generate_client_file=False)
