"""What a new machine gains from the network of a like one: `thermotrue train --from`.

    python bench/start_from.py

A sibling of vmc3 with four runs of 12 hours, judged on twelve others: the network trained on its own four runs, that
of vmc3 (24 runs) as it is, and the one that starts from it. Prints the share of the tip's deviation left.
"""

import contextlib
import io
import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Table

from data_synth.dataset import make_dataset
from data_synth.machines import open_shop
from training.evaluation import NETWORK
from training.job import evaluate_bundle, train_bundle

LIKE, NEW = ("vmc3", 24, 100), ("vmc3~2", 4, 200)
TEST_RUNS, TEST_SEED, HOURS = 12, 300, 12.0


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as name, contextlib.redirect_stderr(io.StringIO()):
        folder = Path(name)
        for what, (machine, runs, seed) in (("like", LIKE), ("new", NEW), ("test", (NEW[0], TEST_RUNS, TEST_SEED))):
            make_dataset(open_shop(machine), runs, HOURS, seed, folder / what, pictures=False)
        train_bundle(folder / "like", folder / "of_like", None, 0)
        train_bundle(folder / "new", folder / "alone", None, 0)
        after = train_bundle(folder / "new", folder / "after", None, 0, folder / "of_like")
        table = Table(title=f"{NEW[0]}, {NEW[1]} runs, judged on {TEST_RUNS} others", title_justify="left")
        for column in ("network", "left [µm]", "share left"):
            table.add_column(column)
        for what, bundle in (
            (f"its own {NEW[1]} runs", "alone"),
            (f"{LIKE[0]}'s, {LIKE[1]} runs", "of_like"),
            ("its own runs, started from that", "after"),
        ):
            score = evaluate_bundle(folder / bundle, folder / "test", None).scores[NETWORK]
            table.add_row(what, f"{score.rms_um:.2f}", f"{score.share:.1%}")
        table.caption = f"pull chosen by folds: {after.bundle.manifest.training['pull']:g}"
    Console(width=90).print(table)


if __name__ == "__main__":
    main()
