"""A thousand mutated bundles, none accepted: damage, edits by mistake, and exports that went wrong."""

import json
import random
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from bundles import packed, resealed

from model.bundle import GEOMETRY, MACHINE, MANIFEST, NETWORK, load_bundle, parse_bundle, read_files, sealed
from model.exceptions import InputError
from model.parity import replay
from model.predictor import Predictor
from model.strict_json import strict_json
from service.machine_state import MachineState
from service.models.archive import unpack
from service.models.fits import Installed, check_fits
from service.schemas import Sample
from service.settings import Settings

TINY = Path(__file__).parent / "data" / "tiny_bundle"
FILES = read_files(TINY)
INSTALLED = Installed.of(load_bundle(TINY))
SETTINGS = Settings()
Files = dict[str, bytes]


def accept(files: Files) -> MachineState:
    """What the service does with an upload, and with a bundle of the command line."""
    bundle = parse_bundle(unpack(packed(files, zipfile.ZIP_STORED)), "upload")
    check_fits(INSTALLED, bundle)
    return MachineState(bundle, SETTINGS, lambda: 0.0, lambda: 0.0)


def refused(files: Files) -> bool:
    try:
        accept(files)
    except InputError:
        return True
    return False


def test_the_bundle_itself_is_accepted_and_so_is_one_written_anew() -> None:
    assert accept(FILES).bundle.version == load_bundle(TINY).version
    assert accept(resealed(FILES)).bundle.version == load_bundle(TINY).version
    slower = resealed({**FILES, MACHINE: FILES[MACHINE].replace(b"per_min = 60.0", b"per_min = 30.0")})
    assert accept(slower).machine.limits.max_rate_um_per_min == 30.0


def damaged(rng: random.Random) -> Files:
    """Return the files as a bad disk, a broken transfer or a person would leave them."""
    name = rng.choice(sorted(FILES))
    content = FILES[name]
    at = rng.randrange(len(content))
    match rng.randrange(7):
        case 0:
            new = content[:at] + bytes([content[at] ^ 1 << rng.randrange(8)]) + content[at + 1 :]
        case 1:
            new = content[:at]
        case 2:
            new = content[:at] + rng.randbytes(rng.randrange(1, 100)) + content[at:]
        case 3:
            end = min(at + rng.randrange(1, 512), len(content))
            new = content[:at] + b"\xff" * (end - at) + content[end:]  # 0xff stands nowhere in these files for long
        case 4:
            lines = content.split(b"\n")
            del lines[rng.randrange(len(lines) - 1)]
            new = b"\n".join(lines)
        case 5:
            return {n: c for n, c in FILES.items() if n != name}
        case _:
            other = rng.choice([n for n in FILES if n != name])
            return {**FILES, name: FILES[other], other: content}
    return {**FILES, name: new} if new != content else damaged(rng)


def leaves(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from leaves(value, (*path, key))


def edited(rng: random.Random) -> Files:
    """Return the files with one value of the manifest changed by hand, and the checksums of the others right."""
    manifest = json.loads(FILES[MANIFEST])
    *path, key = rng.choice(list(leaves(manifest)))
    holder = manifest
    for step in path:
        holder = holder[step]
    value = holder[key]
    numbers = [0.0, -1.0, 1e-300, 1e300, float("nan"), float("inf"), 10**20, True, None, "1", [], {}]
    match rng.randrange(4):
        case 0 if isinstance(value, float) and value:
            holder[key] = value * (1.0 + rng.choice([1e-15, 1e-6, 0.1, -2.0, 1e3]))
        case 1:
            del holder[key]
        case 2 if isinstance(holder, dict):
            holder[f"{key}_"] = holder.pop(key)
        case _:
            holder[key] = rng.choice([n for n in numbers if repr(n) != repr(value)])
    text = json.dumps(manifest, indent=1) + "\n"
    return {**FILES, MANIFEST: text.encode()} if text.encode() != FILES[MANIFEST] else edited(rng)


def misweighted(rng: random.Random) -> Files:
    """Return the files with one weight of the network changed, and everything computed anew."""
    network = onnx.load_from_string(FILES[NETWORK])
    weights = [t for t in network.graph.initializer if t.name in ("linear", "bias", "centre", "mix", "tau_s")]
    tensor = rng.choice(weights)
    values = onnx.numpy_helper.to_array(tensor).copy()
    index = rng.randrange(values.size)
    old = values.flat[index]
    values.flat[index] = rng.choice([old + 0.01, old * 1.01 + 1e-3, -old - 1e-3, 1e300, np.nan, np.inf])
    tensor.CopyFrom(onnx.numpy_helper.from_array(values, tensor.name))
    return resealed({**FILES, NETWORK: network.SerializeToString()})


def rewired(rng: random.Random) -> Files:
    """Return the files with another operator, constant or connection in the network, and everything computed anew."""
    network = onnx.load_from_string(FILES[NETWORK])
    node = rng.choice([n for n in network.graph.node if n.op_type in ("Add", "Sub", "Mul", "Div", "Exp", "Neg", "Pow")])
    match rng.randrange(3):
        case 0:
            node.op_type = {"Add": "Sub", "Sub": "Add", "Mul": "Div", "Div": "Mul", "Exp": "Neg", "Neg": "Exp"}.get(
                node.op_type, "Mul"
            )
        case 1:
            network.graph.node.remove(node)
        case _:
            node.op_type = rng.choice(["Loop", "If", "Scan", "Nothing", "Dropout"])
    return resealed({**FILES, NETWORK: network.SerializeToString()})


SEALED: list[Callable[[dict[str, Any]], object]] = [
    lambda m: m["network"].update(modes=6),
    lambda m: m["network"].update(modes=10**9),
    lambda m: m["network"].update(degree=2),
    lambda m: m["network"].update(degree=-1),
    lambda m: m["network"].update(degree=10**6),
    lambda m: m["network"].update(datum="sometimes"),
    lambda m: m["network"].update(settling_time_s=-1.0),
    lambda m: m["network"].update(settling_time_s=1e300),
    lambda m: m["network"].update(time_constants_s=[]),
    lambda m: m["network"].update(time_constants_s=[300.0, -1.0]),
    lambda m: m["network"].update(terms=[]),
    lambda m: m["network"].update(terms=["EXX", "EC0Y", "EZ0Q"]),
    lambda m: m["network"]["terms"].reverse(),
    lambda m: m["network"].update(sensors=["spindle", "spindle", "ambient"]),
    lambda m: m["network"].update(channels=[]),
    lambda m: m["network"].update(sensors=[]),
    lambda m: m["network"].update(sensor_mean_degC=[25.0, 22.0]),
    lambda m: m["network"].update(sensor_mean_degC=[25.0, 22.0, 1e300]),
    lambda m: m["network"].update(sensor_covariance_K2=[[1e300] * 3] * 3),
    lambda m: m["network"].update(sensor_covariance_K2=[[1.0, 2.0], [2.0, 1.0]]),
    lambda m: m["network"]["valid_range_degC"].update(spindle=[45.0, 15.0]),
    lambda m: m["network"]["valid_range_degC"].update(spindle=[15.0]),
    lambda m: m["network"]["valid_range_channels"].update(oil=[0.0, 1.0]),
    lambda m: m["network"].pop("parity"),
    lambda m: m["network"]["parity"].update(dt_s=[]),
    lambda m: m["network"]["parity"]["inputs"].pop("spindle"),
    lambda m: m["network"]["parity"]["coefficients"].update(EXX=[[0.0, 0.0]] * 8),
    lambda m: m["network"].update(uncertainty={}),
    lambda m: m.update(network=None),
    lambda m: m.update(machine="other"),
    lambda m: m.update(format_version=1),
    lambda m: m.update(unknown=1),
    lambda m: m["files"].pop("geometry.csv"),
    lambda m: m["files"].update({"../../etc/passwd": "0" * 64}),
]
MACHINES = [
    (b'name = "tiny"', b'name = "tina"'),
    (b"w X Y b Z t", b"w Y X b Z t"),
    (b"range = [0.0, 800.0]", b"range = [0.0, 801.0]"),
    (b"range = [0.0, 800.0]", b"range = [800.0, 0.0]"),
    (b"range = [0.0, 800.0]", b"range = [nan, inf]"),
    (b"offset_mm = [0.0, 0.0, -100.0]", b"offset_mm = [0.0, 0.0, 100.0]"),
    (b"errors = true", b"errors = false"),
    (b"max_correction_um = 300.0", b"max_correction_um = 3000.0"),
    (b"max_correction_um = 300.0", b"max_correction_um = 30.0"),
    (b"max_rate_um_per_min = 60.0", b"max_rate_um_per_min = 1e300"),
    (b"max_rate_um_per_min = 60.0", b"max_rate_um_per_min = inf"),
    (b"[sensors.ambient]", b"[sensors.coolant]"),
    (b"range_degC = [-10.0, 50.0]", b"range_degC = [-10.0, 500.0]"),
    (b"temperature_degC = 20.0", b"temperature_degC = 25.0"),
    (b"[limits]", b"[limits]\nspeed = 1"),
    (b"[limits]", b"[limits]\nx = " + b"[" * 50000),
]
GEOMETRIES = [
    b"EXX,0.0,nan\n",
    b"EXX,0.0,inf\n",
    b"EXX,0.0,1e300\n",
    b"EXX,,1.0\n",
    b"EXX,0.0,1.0\nEXX,0.0,1.0\n",
    b"EC0Y,5.0,1.0\n",
    b"EC0Y,,1.0\nEC0Y,,1.0\n",
    b"EQQ,,1.0\n",
    b"EXX,0.0\n",
    b"EXX,zero,1.0\n",
    b"\xff\xfe,0.0,1.0\n",
    b'"EXX,0.0,1.0\n',
]


def miswritten() -> Iterator[Files]:
    """Yield what an exporter with a fault could write: sealed, and still wrong."""
    for change in SEALED:
        yield resealed(FILES, change)
    for old, new in MACHINES:
        assert old in FILES[MACHINE]
        yield resealed({**FILES, MACHINE: FILES[MACHINE].replace(old, new)})
    for rows in GEOMETRIES:
        yield resealed({**FILES, GEOMETRY: b"term,position,value\n" + rows})


DAMAGED, EDITED, MISWEIGHTED, REWIRED = 480, 320, 140, 60


def test_a_thousand_mutated_bundles_none_accepted() -> None:
    rng = random.Random(6)  # noqa: S311 (no secret)
    cases = [("damaged", damaged(rng)) for _ in range(DAMAGED)]
    cases += [("edited", edited(rng)) for _ in range(EDITED)]
    cases += [("misweighted", misweighted(rng)) for _ in range(MISWEIGHTED)]
    cases += [("miswritten", files) for files in miswritten()]
    assert len(cases) >= 1000
    accepted = [f"{kind} {i}" for i, (kind, files) in enumerate(cases) if not refused(files)]
    assert not accepted


def flipped(rng: random.Random) -> Files:
    """Return the files with one bit of the network changed, and everything computed anew."""
    content = bytearray(FILES[NETWORK])
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    return resealed({**FILES, NETWORK: bytes(content)})


@pytest.mark.parametrize("mutated", [flipped, rewired])
def test_a_changed_network_is_refused_or_computes_the_same(mutated: Callable[[random.Random], Files]) -> None:
    """Even with all checksums computed anew: names in a file have no effect, nor has adding a bias of zero."""
    rng, randoms = random.Random(7), np.random.default_rng(7)  # noqa: S311 (no secret)
    dt_s = np.exp(randoms.uniform(-5, 9, 50)) * (np.arange(50) > 0)
    inputs = np.column_stack([randoms.uniform(10, 50, (50, 3)), randoms.uniform(0, 12000, 50)])
    right = Predictor(load_bundle(TINY))
    expected = replay(right._session, right._modes, dt_s, inputs)
    harmless = 0
    for _ in range(REWIRED):
        try:
            state = accept(mutated(rng))
        except InputError:
            continue
        harmless += 1
        assert state.thermal is not None
        found = state.thermal.predictor
        np.testing.assert_allclose(replay(found._session, found._modes, dt_s, inputs), expected, atol=1e-3)
    assert harmless < REWIRED


def test_an_edit_that_is_sealed_is_refused_or_makes_a_bundle_that_works() -> None:
    """Whoever seals an edit gets what it says, where it can be served; nothing breaks in a way of its own."""
    rng = random.Random(8)  # noqa: S311 (no secret)
    worked = 0
    for _ in range(150):
        try:
            manifest = strict_json(edited(rng)[MANIFEST])
            state = accept({**FILES, MANIFEST: sealed(manifest)})
        except (InputError, ValueError):  # JSON that is none is refused before
            continue
        worked += 1
        receipt = state.take([Sample(time=0.0, temperatures={"spindle": 24.0, "column": 22.0, "ambient": 20.0})])
        assert receipt.accepted == 1
        assert np.isfinite(state.compensate(np.array([[400.0, 250.0, 250.0]]), None, 0.0).correction_mm).all()
    assert 0 < worked < 75


def test_a_bundle_of_another_version_of_the_machine_may_not_be_mixed_in() -> None:
    other = resealed({**FILES, MACHINE: FILES[MACHINE].replace(b"per_min = 60.0", b"per_min = 30.0")})
    for name in (MACHINE, MANIFEST):
        with pytest.raises(InputError, match="machine.toml does not match manifest.json"):
            accept({**FILES, name: other[name]})


def test_a_network_replaced_in_memory_is_not_started() -> None:
    with pytest.raises(InputError, match="network.onnx cannot be loaded"):
        MachineState(replace(load_bundle(TINY), network=b"not a network"), SETTINGS, lambda: 0.0, lambda: 0.0)
