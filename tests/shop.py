"""A small data set whose truth is known, for tests of training."""

from pathlib import Path

import numpy as np
from machines import machine_text

from model.tables import read_table, write_table
from model.transforms import Array

TAU_S = 1200.0


def write_dataset(
    folder: Path,
    runs: int = 4,
    hours: float = 6.0,
    *,
    datum: str = "absolute",
    lag: bool = True,
    seed: int = 0,
    structure: str = "w X Y b Z t",
) -> Path:
    """Write runs of one sensor and a spindle: EZ0T = -5 µm per lagged kelvin, EXX = 0.02 µm per kelvin and mm.

    With `lag`, the terms follow the sensor through a first-order lag of TAU_S, from equilibrium at the start.
    """
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "machine.toml").write_text(machine_text(structure, extra="[sensors.ambient]\n"))
    (folder / "dataset.toml").write_text(f'datum = "{datum}"\n')
    telemetry: dict[str, list[float] | list[str]] = {
        c: [] for c in ("run", "time_s", "spindle", "ambient", "spindle_rpm")
    }
    terms: dict[str, list[float] | list[str]] = {c: [] for c in ("run", "time_s", "term", "position", "value")}
    for r in range(runs):
        time_s = np.arange(0.0, hours * 3600.0, 120.0)
        speed = np.repeat(rng.choice([0.0, 3000.0, 9000.0], len(time_s) // 30 + 1), 30)[: len(time_s)]
        spindle = 22.0 + np.cumsum(rng.normal(0, 0.15, len(time_s)))
        lagged = spindle.copy()
        for i in range(1, len(time_s)):
            a = np.exp(-120.0 / TAU_S)
            phi = (1 - a) * TAU_S / 120.0
            lagged[i] = a * lagged[i - 1] + (phi - a) * spindle[i - 1] + (1 - phi) * spindle[i]
        felt = (lagged if lag else spindle) - 20.0
        if datum == "run-start":
            felt = felt - felt[0]
        name = [f"r{r}"] * len(time_s)
        for column, values in (
            ("run", name), ("time_s", time_s), ("spindle", spindle), ("ambient", np.full(len(time_s), 20.0)),
            ("spindle_rpm", speed),
        ):  # fmt: skip
            telemetry[column] += list(values)
        for i in range(0, len(time_s), 3):
            for term, position, value in (
                ("EZ0T", np.nan, -5.0 * felt[i]),
                *(("EXX", p, 0.02 * p * felt[i]) for p in (0.0, 400.0, 800.0)),
            ):
                for column, cell in zip(terms, (f"r{r}", time_s[i], term, position, value), strict=True):
                    terms[column].append(cell)
    write_table(folder / "telemetry.csv", telemetry)
    terms["position"] = ["" if np.isnan(float(p)) else p for p in terms["position"]]
    write_table(folder / "error_terms.csv", terms)
    return folder


def tip_truth(felt: Array, x: Array, structure: str = "w X Y b Z t") -> Array:
    """Return the tip's deviation (n, 3) [µm] of the shop's machine, worked by hand.

    The holder moves by -5 µm in Z per kelvin. With X = 400 mm the X axis' body stands 8 µm in +X per kelvin; the tip
    with it, if it carries the tool, and the tip by as much behind, if it carries the workpiece.
    """
    side = 1.0 if structure.index("X") > structure.index("b") else -1.0
    return np.stack([side * 0.02 * x * felt, 0.0 * felt, -5.0 * felt], axis=1)


def touch(
    folder: Path,
    places: int,
    *,
    every: int = 1,
    again: bool = False,
    runs: tuple[str, ...] = (),
    noise_um: float = 0.0,
    structure: str = "w X Y b Z t",
    seed: int = 1,
) -> Path:
    """Let a probe touch at some places of the working volume, at `every`th time of the error terms.

    With `again`, the places are the same each time, otherwise drawn anew; `runs` restricts it to some runs.
    """
    rng = np.random.default_rng(seed)
    table = read_table(folder / "error_terms.csv", text=("run", "term"))
    z = np.flatnonzero(table.text["term"] == "EZ0T")[::every]
    z = z[[not runs or name in runs for name in table.text["run"][z]]]
    low, high = np.array([0.0, -250.0, 0.0]), np.array([800.0, 250.0, 500.0])
    fixed = rng.uniform(low, high, (places, 3))
    q = np.tile(fixed, (len(z), 1)) if again else rng.uniform(low, high, (len(z) * places, 3))
    rows = np.repeat(z, places)
    felt = -table.numbers["value"][rows] / 5.0
    deviation = tip_truth(felt, q[:, 0], structure) + rng.normal(0.0, 1.0, (len(q), 3)) * noise_um
    columns = {"run": table.text["run"][rows].tolist(), "time_s": table.numbers["time_s"][rows]}
    columns |= dict(zip("XYZ", q.T, strict=True)) | dict(zip(("dx_um", "dy_um", "dz_um"), deviation.T, strict=True))
    write_table(folder / "tool_tip.csv", columns)
    return folder
