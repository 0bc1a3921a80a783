"""How many positions a second are compensated, against other engines' forward kinematics and against memory.

    python bench/kinematics.py [MACHINE ...]

For each machine (presets; vmc3 and trunnion5 by default), in one run: exact compensated positions a second on one
core and on two, with every residual checked; as ratios to it the forward kinematics alone of a straightforward NumPy
4x4 chain (with errors), of pinocchio and of pytorch_kinematics (both ideal, since neither knows errors nor
compensation), and a copy of the same positions in memory as the limit. The engines must agree on the tip before they
are timed. Needs `pip install -e '.[train,dev,bench]'`.
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from model.chain import Chain
from model.compensation import RESIDUAL_MM, Compensator
from model.error_map import ErrorMap
from model.machine import load_machine, preset
from model.transforms import Array

SECONDS = 1.0
"""How long each is repeated; the fastest of `REPEATS` such stretches counts, since others use the machine, too."""
REPEATS = 3
POSITIONS = 1_000_000


def errors_of_a_warm_machine(chain: Chain, rng: np.random.Generator) -> ErrorMap:
    """Return thermal terms at 161 knots an axis plus geometric ones at 26: some 30 µm and 50 µrad."""
    machine = chain.machine
    rows: list[tuple[str, float | None, float]] = []
    for term in machine.terms:
        size = 50.0 if term.angular else 30.0
        if term.kind == "location":
            rows.append((term.name, None, float(rng.normal(0.0, size))))
    whole = ErrorMap.from_rows(machine, rows)
    for knots in (161, 26):
        rows = []
        for term in machine.terms:
            if term.kind == "motion":
                axis = machine.axes[term.axis]
                wave = (50.0 if term.angular else 30.0) * rng.normal(size=4)
                for p in np.linspace(0.0, 1.0, knots):
                    value = float(wave @ [p, p**2, np.sin(6 * p), np.cos(15 * p)])
                    rows.append((term.name, axis.low + p * (axis.high - axis.low), value))
        whole = whole + ErrorMap.from_rows(machine, rows)
    return whole


def urdf(chain: Chain) -> str:
    """Return the ideal chain from the workpiece to the tool tip as URDF, the format that the other engines read."""
    machine = chain.machine
    links, joints = ['<link name="work"/>'], []
    last = "work"

    def joint(name: str, kind: str, offset: Array, axis: Array | None = None) -> None:
        nonlocal last
        links.append(f'<link name="{name}"/>')
        along = "" if axis is None else f'<axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>'
        limit = "" if kind == "fixed" else '<limit lower="-1e4" upper="1e4" effort="1" velocity="1"/>'
        joints.append(
            f'<joint name="j_{name}" type="{kind}"><parent link="{last}"/><child link="{name}"/>'
            f'<origin xyz="{offset[0]} {offset[1]} {offset[2]}" rpy="0 0 0"/>{along}{limit}</joint>'
        )
        last = name

    for body in reversed(chain.work_path):
        axis = chain.axis_of(body)
        if axis is not None:  # downwards: back by the motion, then by the origin
            joint(axis.name, "revolute" if axis.rotary else "prismatic", np.zeros(3), -np.asarray(axis.direction))
            joint(f"under_{axis.name}", "fixed", -np.asarray(axis.origin_mm))
    for body in chain.tool_path:
        axis = chain.axis_of(body)
        if axis is not None:
            origin = np.asarray(axis.origin_mm, dtype=float)
            joint(axis.name, "revolute" if axis.rotary else "prismatic", origin, np.asarray(axis.direction))
    joint("tip", "fixed", np.asarray(machine.tool.offset_mm))
    return f'<robot name="machine">{"".join(links)}{"".join(joints)}</robot>'


def rate(work: Callable[[], object], positions: int) -> float:
    """Return positions a second, the best of some stretches."""
    work()
    best = 0.0
    for _ in range(REPEATS):
        done, start = 0, time.perf_counter()
        while (spent := time.perf_counter() - start) < SECONDS:
            work()
            done += positions
        best = max(best, done / spent)
    return best


def compare(name: str) -> Table:
    """Return the table of one machine."""
    chain = Chain(load_machine(preset(name)))
    rng = np.random.default_rng(0)
    errors = errors_of_a_warm_machine(chain, rng)
    axes = [chain.machine.axes[a] for a in chain.machine.axis_names]
    # A tenth inside the ranges, so that corrections stay in them.
    low, high = np.array([a.low for a in axes]), np.array([a.high for a in axes])
    q = rng.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low), (POSITIONS, len(axes)))
    compensator = Compensator(chain, errors)
    found = compensator.compensate(q[:10_000])
    tip = chain.tip(found.corrected, errors.evaluate(found.corrected))
    off = np.linalg.norm(tip - chain.tip(q[:10_000]), axis=1).max()
    assert off <= RESIDUAL_MM, off

    one, two = (rate(lambda n=n: compensator.compensate(q, threads=n), POSITIONS) for n in (1, 2))
    table = Table(title=f"{name}: {len(axes)} axes, {len(chain.machine.terms)} error terms", title_justify="left")
    for column in ("what", "positions/s", "compensated on two cores is"):
        table.add_column(column, justify="left" if column == "what" else "right")
    table.add_row("compensated, exact, one core", f"{one:,.0f}", f"{two / one:.2f} times it")
    table.add_row("compensated, exact, two cores", f"{two:,.0f}", "")
    for what, value in engines(chain, errors, q).items():
        table.add_row(what, f"{value:,.0f}", f"{two / value:,.3g} times it")
    table.caption = f"farthest tip of 10,000 after compensation, by the NumPy chain: {off * 1e6:.4f} nm"
    return table


def engines(chain: Chain, errors: ErrorMap, q: Array) -> dict[str, float]:
    """Return the rates of the others, after checking that they compute the same tip."""
    import pinocchio as pin  # noqa: PLC0415 (what measures memory does without)
    import pytorch_kinematics as pk  # noqa: PLC0415
    import torch  # noqa: PLC0415

    some = q[:2000]
    internal = some * [chain.machine.axes[a].to_internal for a in chain.machine.axis_names]
    expected = chain.tip(some)
    text = urdf(chain)

    tree = pin.buildModelFromXML(text)
    data, frame = tree.createData(), tree.getFrameId("tip")
    columns = [chain.machine.axis_names.index(n.removeprefix("j_")) for n in tree.names[1:]]
    ordered = np.ascontiguousarray(internal[:, columns])

    def by_pinocchio() -> Array:
        tips = np.empty((len(ordered), 3))
        for i, coordinates in enumerate(ordered):
            pin.forwardKinematics(tree, data, coordinates)
            tips[i] = pin.updateFramePlacement(tree, data, frame).translation
        return tips

    serial = pk.build_serial_chain_from_urdf(text.encode(), "tip").to(dtype=torch.float64)
    names = [n.removeprefix("j_") for n in serial.get_joint_parameter_names()]
    batch = torch.tensor(np.tile(internal, (10, 1))[:, [chain.machine.axis_names.index(n) for n in names]])

    def by_torch() -> Array:
        with torch.no_grad():
            tips: Array = serial.forward_kinematics(batch).get_matrix()[:, :3, 3].numpy()
        return tips

    np.testing.assert_allclose(by_pinocchio(), expected, atol=1e-8)
    np.testing.assert_allclose(by_torch()[: len(some)], expected, atol=1e-8)
    terms = errors.evaluate(some)
    into = np.empty_like(q)
    return {
        "NumPy 4x4 chain with errors, forward only": rate(lambda: chain.tip(some, terms), len(some)),
        "pinocchio, ideal, forward only, called pose by pose": rate(by_pinocchio, len(some)),
        "pytorch_kinematics, ideal, forward only, batched": rate(by_torch, len(batch)),
        "memory copy of the coordinates": rate(lambda: np.copyto(into, q), len(q)),
    }


def memory(name: str, positions: int) -> float:
    """Return the peak memory of a process that compensates so many, less positions and results [MB]."""
    chain = Chain(load_machine(preset(name)))
    compensator = Compensator(chain, errors_of_a_warm_machine(chain, np.random.default_rng(0)))
    axes = [chain.machine.axes[a] for a in chain.machine.axis_names]
    q = np.empty((positions, len(axes)))
    q[:] = [0.5 * (a.low + a.high) for a in axes]
    found = compensator.compensate(q)
    results = sum(part.nbytes for part in (found.corrected, found.residual_mm, found.tilt_rad, found.deviation_mm))
    status = Path("/proc/self/status").read_text()  # what getrusage says counts the parent, too
    peak_kib = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
    return peak_kib * 1024 / 1e6 - (q.nbytes + results) / 1e6


def main() -> None:
    """Print a table for each machine."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("machines", nargs="*", default=["vmc3", "trunnion5"])
    parser.add_argument("--memory", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.memory:
        print(memory(arguments.machines[0], arguments.memory))
        return
    console = Console(width=110)
    for name in arguments.machines:
        console.print(compare(name))
        for positions in (1_000_000, 8_000_000):
            command = [sys.executable, __file__, name, "--memory", str(positions)]
            beyond = float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
            console.print(f"  {positions:>9,} positions: peak memory {beyond:.0f} MB beside positions and results")


if __name__ == "__main__":
    main()
