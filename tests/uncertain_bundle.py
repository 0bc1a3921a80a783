"""The tiny bundle with a record of how far its predictions may be off."""

from pathlib import Path
from typing import Any

from bundles import resealed

TINY = Path(__file__).parent / "data" / "tiny_bundle"
SIZE = 1.3
"""How many times as far off as usual its predictions are in states like its training's."""


def uncertain_bundle(folder: Path) -> Path:
    """Write the tiny bundle there with a record: EXX uncertain by a micrometre, EZ0T by two, EC0Y by 1 µrad.

    Its head leans by 30 µrad about Y, too, so that the tool's length matters.
    """
    path = folder / "uncertain"
    path.mkdir()
    files = {f.name: f.read_bytes() for f in TINY.iterdir()}
    files["geometry.csv"] += b"EB0Z,,30\n"

    def add(manifest: dict[str, Any]) -> None:
        modes = manifest["network"]["modes"]
        manifest["network"]["uncertainty"] = {
            # Coefficients: EXX's mean and slope, EC0Y, EZ0T.
            "directions": [[1.0, 0.0, 0.0, 0.0], [0.0, 0.5, 1.0, 0.0], [0.0, 0.0, 0.0, 2.0]],
            "mode_size": [0.1] * modes,
            "seen_directions": [[1.0 if k == m else 0.0 for k in range(modes)] for m in range(modes - 1)],
            "floor": SIZE**2,
            "rise": 0.5,
            "misfit_um": 0.2,
            "scale": 1.0,
            "quantile": 1.96,
            "parts": 4,
            "independent": 50.0,
            "data": "made up for tests",
        }

    for name, content in resealed(files, add).items():
        (path / name).write_bytes(content)
    return path
