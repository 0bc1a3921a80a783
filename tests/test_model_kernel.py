"""The compiled path: it obeys the NumPy chain, position by position, and is never compiled when a request waits."""

import hashlib
import os
import shutil
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from machines import five_axis_text, machine_text
from test_model_compensation import random_errors
from test_model_five_axis import CHAINS, poses

from model import kernel, kernel_cache, kernel_object
from model.chain import Chain
from model.compensation import SHARE, Compensator, compensate
from model.error_map import ErrorMap
from model.exceptions import ComputeError, DataError
from model.kernel import LANES
from model.kernel_plan import LARGEST_RAD, plan
from model.machine import Machine, load_machine, parse_machine, preset

PRESETS = sorted(p.stem for p in preset("vmc3").parent.glob("*.toml"))


def uneven_errors(machine: Machine, rng: np.random.Generator) -> ErrorMap:
    """Return terms of up to 1 mm and 1 mrad at few knots, some close together, some far from the ends of the axis."""
    rows: list[tuple[str, float | None, float]] = []
    for term in machine.terms:
        if term.kind == "location":
            rows.append((term.name, None, rng.uniform(-1000, 1000)))
            continue
        axis = machine.axes[term.axis]
        span = axis.high - axis.low
        knots = np.unique(np.round(rng.uniform(axis.low + 0.1 * span, axis.high, rng.integers(1, 9)), 2))
        value = rng.uniform(-500, 500)
        for k, p in enumerate(knots):
            value += 0.0 if k == 0 else rng.uniform(-1, 1) * min(300.0, 3000.0 * (p - knots[k - 1]) / span)
            rows.append((term.name, float(p), value))
    return ErrorMap.from_rows(machine, rows)


@pytest.mark.parametrize("name", PRESETS)
@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=6)
def test_it_looks_terms_up_as_the_error_map_does(name: str, seed: int) -> None:
    """On, between and beyond knots; the chain in NumPy is the judge."""
    rng = np.random.default_rng(seed)
    chain = Chain(load_machine(preset(name)))
    errors = uneven_errors(chain.machine, rng)
    q = poses(chain, 40, rng)
    for column, axis in enumerate(chain.machine.axis_names):
        on_knot = rng.random(len(q)) < 0.3
        q[on_knot, column] = rng.choice(errors.knots[axis], on_knot.sum())
    kept = chain.machine.axis_names  # nothing may move, so what is left is the deviation itself
    found = compensate(chain, q, errors, keep=kept)
    deviation = chain.deviation(q, errors.evaluate(q))
    np.testing.assert_array_equal(found.corrected, q)
    np.testing.assert_allclose(found.residual_mm, np.linalg.norm(deviation.position_mm, axis=1), atol=1e-10)
    free = compensate(chain, q, errors)
    tip = chain.tip(free.corrected, errors.evaluate(free.corrected))
    np.testing.assert_allclose(tip, chain.tip(q), atol=1e-6)


def test_knots_closer_than_a_cell_are_found() -> None:
    """Two knots a micrometre apart on an axis of 800 mm: a step, as tables of pitch errors have them."""
    chain = Chain(parse_machine(machine_text("w Y b X Z t")))
    values = [(0.0, 0.0), (400.0, 8.0), (400.001, 20.0), (400.002, 5.0), (800.0, 5.0)]
    errors = ErrorMap.from_rows(chain.machine, [("EYX", p, v) for p, v in values])
    q = np.zeros((9, 3))
    q[:, 0] = [-5.0, 0.0, 200.0, 400.0, 400.0005, 400.001, 400.0015, 400.002, 900.0]
    found = compensate(chain, q, errors)
    expected = np.interp(q[:, 0], *zip(*values, strict=True))
    np.testing.assert_allclose(q[:, 1] - found.corrected[:, 1], expected * 1e-3, atol=1e-9)


@given(st.sampled_from(CHAINS), st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=20)
def test_a_position_does_not_depend_on_its_neighbours(chain: Chain, seed: int) -> None:
    """Not on those it shares a block with, not on their order, not on the number of threads."""
    rng = np.random.default_rng(seed)
    compensator = Compensator(chain, random_errors(chain.machine, rng))
    q = poses(chain, 3 * LANES - 7, rng)
    whole = compensator.compensate(q)
    order = rng.permutation(len(q))
    np.testing.assert_allclose(compensator.compensate(q[order]).corrected, whole.corrected[order], atol=1e-7)
    for i in rng.integers(0, len(q), 5):
        alone = compensator.compensate(q[i : i + 1])
        np.testing.assert_allclose(alone.corrected[0], whole.corrected[i], atol=1e-7)


def test_threads_change_nothing() -> None:
    rng = np.random.default_rng(3)
    compensator = Compensator(CHAINS[0], random_errors(CHAINS[0].machine, rng, 0.05))
    q = poses(CHAINS[0], 2 * SHARE + 77, rng)
    one, three = compensator.compensate(q, threads=1), compensator.compensate(q, threads=3)
    for name in ("corrected", "residual_mm", "tilt_rad", "outside"):
        np.testing.assert_array_equal(getattr(one, name), getattr(three, name))


QUILL = ("w b X Y Z B W t", "w b X Y Z C B W t", "w W C b X Y Z A t")
"""Linear axes on rotary ones, on either side."""


def quill_chain(structure: str) -> Chain:
    ranges = {"W": (-150.0, 150.0), "A": (-100.0, 100.0), "B": (-100.0, 100.0), "C": (-360.0, 360.0)}
    axes = "".join(
        f"[axes.{a}]\nrange = {list(ranges.get(a, (0.0, 500.0)))}\n"
        + ("direction = [0.0, 0.0, 1.0]\n" if a == "W" else "")
        for a in structure.split()
        if a not in "wbt"
    )
    return Chain(parse_machine(f'name = "quill"\nstructure = "{structure}"\n{axes}[tool]\nerrors = true\n'))


@pytest.mark.parametrize("structure", QUILL)
def test_a_linear_axis_on_a_rotary_one_is_used_where_it_points(structure: str) -> None:
    chain = quill_chain(structure)
    rng = np.random.default_rng(9)
    errors = random_errors(chain.machine, rng)
    q = poses(chain, 200, rng)
    for keep in ((), ("Z",)):
        found = compensate(chain, q, errors, keep=keep)
        tip = chain.tip(found.corrected, errors.evaluate(found.corrected))
        left = np.linalg.norm(tip - chain.tip(q), axis=1)
        np.testing.assert_allclose(found.residual_mm, left, atol=1e-9)
        names = [a for a in chain.machine.axis_names if not chain.machine.axes[a].rotary and a not in keep]
        columns = [chain.machine.axis_names.index(a) for a in names]
        reach = np.linalg.svd(chain.jacobian(found.corrected)[:, :3, columns], compute_uv=False).min(axis=1)
        assert (left[reach > 0.1] <= 1e-6).all()
        assert (reach > 0.1).any()
        moved = np.abs(found.corrected - q)[:, columns]
        assert moved.max() <= 20.0 / kernel.SINGULAR  # bounded where the quill lies across what it should undo


def test_rotary_axes_stay_where_the_linear_ones_cannot_follow() -> None:
    """Position first: turning the tool back would take the tip along, and X must not move."""
    rng = np.random.default_rng(6)
    for chain in (CHAINS[0], Chain(load_machine(preset("trunnion5")))):
        errors = random_errors(chain.machine, rng)
        q = poses(chain, 500, rng)
        names = chain.machine.axis_names
        rotary = [i for i, a in enumerate(names) if chain.machine.axes[a].rotary]
        found = compensate(chain, q, errors, keep=("X",))
        np.testing.assert_array_equal(found.corrected[:, rotary], q[:, rotary])
        before = compensate(chain, q, errors, keep=names).residual_mm
        assert (found.residual_mm <= before + 0.05).all()  # the terms of another place differ by their slopes


SLANTED = "direction = [0.0, 0.70710678118654752, 0.70710678118654752]\n"


def many_rotary_axes(structure: str, slanted: str = "") -> Chain:
    axes = "".join(
        f"[axes.{a}]\nrange = {[-360.0, 360.0] if a in 'ABC' else [-300.0, 300.0]}\n"
        f"origin_mm = {[20.0, -30.0, 50.0] if a in 'ABC' else [0.0, 0.0, 0.0]}\n" + (SLANTED if a == slanted else "")
        for a in structure.split()
        if a not in "wbt"
    )
    tool = "[tool]\noffset_mm = [0.0, 0.0, -150.0]\nerrors = true\n"
    return Chain(parse_machine(f'name = "many"\nstructure = "{structure}"\n{axes}{tool}'))


@pytest.mark.parametrize(
    ("structure", "slanted", "poles"),
    [
        ("w X b Y Z C B t", "B", {"B": (0.0, 180.0)}),  # a nutating head: tool upright, tool level
        ("w C B b X Y Z t", "B", {"B": (0.0, 180.0)}),
        ("w C B A b X Y Z t", "", {"A": (90.0, -90.0), "B": (90.0, -90.0)}),
        ("w b X Y Z C B A t", "", {"A": (90.0, -90.0), "B": (90.0, -90.0)}),
    ],
)
def test_where_rotary_axes_reach_no_further_they_do_not_run_away(
    structure: str, slanted: str, poles: dict[str, tuple[float, float]]
) -> None:
    """At the end of their reach a turn tilts the tool as its square: steps from the slope alone go round and round."""
    chain = many_rotary_axes(structure, slanted)
    names = chain.machine.axis_names
    rotary = [i for i, a in enumerate(names) if chain.machine.axes[a].rotary]
    rng = np.random.default_rng(8)
    for _ in range(4):
        errors = random_errors(chain.machine, rng)
        q = poses(chain, 300, rng)
        for axis, places in poles.items():
            q[:, names.index(axis)] = rng.choice(places, len(q)) + rng.uniform(-3, 3, len(q))
        found = compensate(chain, q, errors)
        before = compensate(chain, q, errors, keep=names).tilt_rad
        assert found.residual_mm.max() <= 1e-6
        turned = np.radians(np.linalg.norm((found.corrected - q)[:, rotary], axis=1))
        assert (turned <= 2.0 * before / kernel.SINGULAR + kernel.SLACK_RAD + 1e-9).all()
        assert (found.tilt_rad <= before + 5e-4).all()  # terms of another place, where axes went far
        turned_axis = chain.pose(found.corrected, errors.evaluate(found.corrected))[1][:, :, 2]
        sine = np.linalg.norm(np.cross(turned_axis, chain.pose(q)[1][:, :, 2]), axis=1)
        np.testing.assert_allclose(found.tilt_rad, np.arcsin(sine), atol=1e-12)


def test_three_rotary_axes_share_the_turn_whatever_their_neighbours() -> None:
    chain = many_rotary_axes("w b X Y Z A B C t")
    rng = np.random.default_rng(4)
    compensator = Compensator(chain, random_errors(chain.machine, rng, 0.3))
    q = poses(chain, 2 * LANES, rng)
    alone = np.concatenate([compensator.compensate(q[i : i + 1]).corrected for i in range(len(q))])
    np.testing.assert_allclose(compensator.compensate(q).corrected, alone, atol=1e-6)


def test_what_has_another_shape_is_refused() -> None:
    """Compiled code looks nothing up twice: it would read and write beyond its arrays."""
    chain = CHAINS[0]
    errors = ErrorMap.zero(chain.machine)
    for shape in ((3, 4), (3, 6), (5,), (0,)):
        with pytest.raises(
            DataError, match=r"coordinates must have shape \(n, 5\), one column for each of X, Y, Z, A, C"
        ):
            compensate(chain, np.zeros(shape), errors)
    for tool in (np.zeros(2), np.zeros(4), np.array([0.0, 0.0, np.inf])):
        with pytest.raises(DataError, match="the tool tip must be three finite numbers of mm, got"):
            compensate(chain, np.zeros((1, 5)), errors, tool)


def test_what_runs_away_is_refused_whatever_the_axes_reach() -> None:
    chain = Chain(parse_machine(machine_text("w Y b X Z t")))
    errors = random_errors(chain.machine, np.random.default_rng(1))
    with (
        np.errstate(all="ignore"),
        pytest.raises(ComputeError, match="compensation at X .* must reach 1 nm, got a res"),
    ):
        compensate(CHAINS[0], np.full((1, 5), 1.7e308), ErrorMap.zero(CHAINS[0].machine), keep=("X",))
    assert compensate(chain, np.zeros((1, 3)), errors, keep=("X",)).residual_mm[0] > 1e-6


def test_what_is_not_a_number_is_refused() -> None:
    chain = Chain(parse_machine(machine_text("w Y b X Z t")))
    errors = random_errors(chain.machine, np.random.default_rng(1))
    q = np.zeros((SHARE + 5, 3))
    q[SHARE + 3, 1] = np.nan
    with pytest.raises(DataError, match=f"coordinates must be finite numbers, got others in row {SHARE + 4}"):
        compensate(chain, q, errors)
    with pytest.raises(DataError, match="motion terms of axis 'X' must be finite"):
        compensate(chain, np.zeros((1, 3)), errors.scaled(np.nan))
    with pytest.raises(DataError, match=r"angles within ±0.1 rad, got 0.2"):
        compensate(chain, np.zeros((1, 3)), ErrorMap.from_rows(chain.machine, [("EAX", 0.0, 2e6 * LARGEST_RAD)]))
    with pytest.raises(DataError, match=r"location terms must be finite, and angles within ±0.1 rad, got 0.2"):
        compensate(chain, np.zeros((1, 3)), ErrorMap.from_rows(chain.machine, [("EA0X", None, 2e6 * LARGEST_RAD)]))


def test_large_coordinates_stay_in_the_tables() -> None:
    """Whatever a coordinate, a table is looked up within its bounds: there it is constant."""
    chain = Chain(parse_machine(machine_text("w Y b X Z t")))
    errors = ErrorMap.from_rows(chain.machine, [("EXX", 0.0, 10.0), ("EXX", 800.0, 20.0)])
    found = compensate(chain, np.array([[1e12, 0.0, 0.0], [-1e12, 0.0, 0.0]]), errors, keep=("X", "Y", "Z"))
    np.testing.assert_allclose(found.residual_mm, [0.020, 0.010], atol=1e-3)  # a double at 1e12 carries 0.1 µm


def test_small_and_large_angles_have_the_sines_they_should() -> None:
    """A rotary axis through several turns, and error angles up to the largest taken."""
    chain = Chain(parse_machine(five_axis_text("w C A Y X b Z t")))
    rng = np.random.default_rng(2)
    c = chain.machine.axis_names.index("C")
    q = poses(chain, 500, rng)
    q[:, c] = np.concatenate([rng.uniform(-2000, 2000, 468), np.arange(-720, 720, 45)])
    for size in (1.0, 0.999 * LARGEST_RAD / 1e-3):
        errors = random_errors(chain.machine, rng, size)
        found = compensate(chain, q, errors, keep=chain.machine.axis_names)
        deviation = chain.deviation(q, errors.evaluate(q))
        np.testing.assert_allclose(
            found.residual_mm, np.linalg.norm(deviation.position_mm, axis=1), rtol=1e-12, atol=1e-10
        )


def test_compiled_code_is_given_nothing_but_what_it_takes_arrays_for() -> None:
    """It is called with addresses, and would read and write whatever is there."""
    prepared = plan(CHAINS[0], ErrorMap.zero(CHAINS[0].machine), None)
    good = [np.zeros((4, 5)), 0, 4, np.zeros(40)]
    prepared.solve(*good)
    wrong = (0, np.zeros((4, 5), dtype=np.float32)), (0, np.zeros((4, 10))[:, ::2]), (2, 5), (1, -1), (3, np.zeros(39))
    for place, value in (*wrong, (0, np.zeros((5, 5))), (3, np.zeros(40, dtype=np.int64))):
        with pytest.raises((TypeError, IndexError), match="the compiled path needs|positions .* must lie within 4"):
            prepared.solve(*[value if i == place else v for i, v in enumerate(good)])


LOADED = "import sys, model.kernel; print('numba' in sys.modules)"


def start(folder: Path, code: str = LOADED) -> subprocess.CompletedProcess[str]:
    """Import the path in a process of its own; it says whether the compiler is there."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """A folder with the path as it is kept here."""
    content = kernel_cache._kept()
    assert content is not None
    digest = hashlib.sha256(content).hexdigest().encode()
    (tmp_path / kernel_cache._name()).write_bytes(digest + b"\n" + content)
    return tmp_path


def test_it_is_loaded_without_the_compiler(kept: Path) -> None:
    done = start(kept)
    assert (done.stdout, done.stderr) == ("False\n", "")


def test_what_was_kept_and_has_changed_is_compiled_anew(
    kept: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A byte of it is enough; the new one takes its place. Compiling itself takes long, and so is done elsewhere."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(kept))
    good = kernel_cache._kept()
    assert good is not None
    [file] = kept.iterdir()
    changed = bytearray(file.read_bytes())
    changed[5000] ^= 1
    file.write_bytes(changed)
    assert kernel_cache._kept() is None
    assert kernel_cache._keep(good) == good
    assert kernel_cache._kept() == good
    assert [p.name for p in kept.iterdir()] == [kernel_cache._name()]


def test_without_a_folder_it_still_runs_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file" / "folder"))
    assert kernel_cache._keep(b"code") == b"code"
    assert kernel_cache._kept() is None
    assert "set NUMBA_CACHE_DIR to a folder that can be written to" in caplog.text


def test_another_source_or_processor_has_another_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = {kernel_cache._name()}
    with monkeypatch.context() as patch:
        patch.setattr(kernel_cache, "_processor", lambda: "another")
        names.add(kernel_cache._name())
    for source in kernel_cache.SOURCES:
        shutil.copy(kernel_cache.HERE / source, tmp_path)
    monkeypatch.setattr(kernel_cache, "HERE", tmp_path)
    for source in kernel_cache.SOURCES:
        (tmp_path / source).write_text((tmp_path / source).read_text(encoding="utf-8") + "#", encoding="utf-8")
        names.add(kernel_cache._name())
    assert len(names) == 5


@pytest.mark.skipif(not kernel_object.SUPPORTED, reason="object code is loaded on Linux alone")
@pytest.mark.parametrize("what", ["empty", "elf", "short", "name", "outside", "relocation"])
def test_object_code_that_is_not_as_expected_is_refused(what: str) -> None:
    content = kernel_cache._kept()
    assert content is not None
    first, _, code = content.partition(b"\n")
    name = first.decode()
    broken = {
        "empty": b"",
        "elf": b"\x7fELF\x02\x02" + code[6:],
        "short": code[:5000],
        "name": code,
        "outside": code.replace(b"\0atan2\0", b"\0dlsym\0"),
        "relocation": code,
    }[what]
    if what == "relocation":
        linker = kernel_object._Linker(code)
        table = next(s for s in linker._sections if s.kind == kernel_object.RELA and s.info in linker._places)
        changed = bytearray(code)
        changed[table.offset + 8] = 99
        broken = bytes(changed)
    with pytest.raises(kernel_object.ObjectError, match="^object code "):
        kernel_object.load(broken, "another" if what == "name" else name)


def test_code_is_executable_and_not_writable() -> None:
    content = kernel_cache._kept()
    assert content is not None
    name, _, code = content.partition(b"\n")
    loaded = kernel_object.load(code, name.decode())
    for line in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines():
        begin, end = (int(part, 16) for part in line.split()[0].split("-"))
        if begin <= loaded.address < end:
            assert line.split()[1].startswith("r-x")
            break
    else:
        pytest.fail("the code is nowhere")


def test_where_object_code_cannot_be_loaded_the_compiler_does_it(monkeypatch: pytest.MonkeyPatch) -> None:
    class Path_:
        address = 0

    asked: list[bool] = []

    def compiled(*, keep_object: bool) -> Path_:
        asked.append(keep_object)
        if keep_object:
            raise RuntimeError("cannot cache function 'entry': no locator available")
        return Path_()

    builder = types.ModuleType("model.kernel_build")
    builder.compiled = compiled  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "model.kernel_build", builder)
    monkeypatch.setattr(kernel_cache, "SUPPORTED", False)
    _, stays = kernel_cache.entry()
    assert isinstance(stays, Path_)
    assert asked == [True, False]
