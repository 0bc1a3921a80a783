"""How fast the synthetic shop makes data, and how much memory it needs.

    python bench/synth.py [--machine vmc3] [--hours 10000]

Makes data sets of 12-hour runs in fresh processes, one quarter of the machine-hours and all of them, with one worker
and with two, and prints wall time, processor time and peak memory (of the largest process). Ratios compare figures
of this same run: all with a quarter (memory should not grow), two workers with one, and one worker with only writing
the finished tables again. Wall time means something only where nobody else uses the computer; processor time does
anyway.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from pyarrow import parquet
from rich.console import Console
from rich.table import Table

RUN_H = 12.0
QUIET = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def processor_s() -> float:
    """Return the processor time of this process and of its children that have ended."""
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def peak_MB() -> float:
    """Return the peak memory of the largest process."""
    whos = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(who).ru_maxrss for who in whos) / 1024.0  # kilobytes on Linux


def measure(machine: str, runs: int, workers: int, again: bool) -> dict[str, float]:
    """Make a data set in this process; with `again`, also write its finished tables once more."""
    from data_synth.dataset import make_dataset  # noqa: PLC0415 (the parent needs none of it)
    from data_synth.machines import open_shop  # noqa: PLC0415

    with TemporaryDirectory() as folder:
        out = Path(folder) / "data"
        wall, processor = time.perf_counter(), processor_s()
        make_dataset(open_shop(machine), runs, RUN_H, 0, out, workers=workers)
        found = {"wall_s": time.perf_counter() - wall, "processor_s": processor_s() - processor, "peak_MB": peak_MB()}
        if again:
            found["writing_s"] = sum(write_again(file) for file in sorted(out.glob("*.parquet")))
        found["size_MB"] = sum(file.stat().st_size for file in out.iterdir()) / 1e6
    return found


def write_again(file: Path) -> float:
    """Return the processor time of writing a finished table again, row group by row group."""
    source, took = parquet.ParquetFile(file), 0.0
    with parquet.ParquetWriter(file.with_suffix(".again"), source.schema_arrow, compression="zstd") as writer:
        for group in range(source.num_row_groups):
            table = source.read_row_group(group)
            start = time.process_time()
            writer.write_table(table)
            took += time.process_time() - start
    file.with_suffix(".again").unlink()
    return took


def apart(machine: str, runs: int, workers: int, again: bool = False) -> dict[str, float]:
    """Measure in a fresh process, whose peak memory is its own."""
    one = ["--one", str(runs), str(workers), str(int(again))]
    command = [sys.executable, __file__, "--machine", machine, *one]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, env=os.environ | QUIET)
    found: dict[str, float] = json.loads(done.stdout)
    return found


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", default="vmc3")
    parser.add_argument("--hours", type=float, default=10000.0)
    parser.add_argument("--one", nargs=3, type=int, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        runs, workers, again = asked.one
        print(json.dumps(measure(asked.machine, runs, workers, bool(again))))
        return
    runs = round(asked.hours / RUN_H)
    cases = [(runs // 4, 1), (runs, 1), (runs // 4, 2), (runs, 2)]
    found = {case: apart(asked.machine, *case, again=case == (runs, 1)) for case in cases}
    table = Table(title=f"{asked.machine}, runs of {RUN_H:g} h at one minute", title_justify="left")
    for column in (
        "machine-hours",
        "workers",
        "wall [s]",
        "processor [s]",
        "machine-hours/s",
        "peak [MB]",
        "size [MB]",
    ):
        table.add_column(column, justify="right")
    for (n, workers), one in found.items():
        hours = n * RUN_H
        rate = hours / one["wall_s"]
        cells = (one["wall_s"], one["processor_s"], rate, one["peak_MB"], one["size_MB"])
        table.add_row(f"{hours:.0f}", str(workers), *(f"{cell:.0f}" if cell > 100 else f"{cell:.1f}" for cell in cells))
    Console(width=110).print(table)
    for workers in (1, 2):
        ratio = found[runs, workers]["peak_MB"] / found[runs // 4, workers]["peak_MB"]
        print(f"peak memory with {workers} worker(s), all to a quarter: {ratio:.2f}")
    print(f"wall time, two workers to one: {found[runs, 2]['wall_s'] / found[runs, 1]['wall_s']:.2f}")
    alone = found[runs, 1]
    print(f"processor time to that of writing the tables alone: {alone['processor_s'] / alone['writing_s']:.1f}")


if __name__ == "__main__":
    main()
