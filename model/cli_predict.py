"""`thermotrue predict`: run a bundle's network over telemetry and say where the tip was."""

from __future__ import annotations

from pathlib import Path

import click

PATH = click.Path(path_type=Path)


@click.command()
@click.argument("bundle", type=PATH)
@click.argument("telemetry", type=PATH)
@click.option("--positions", required=True, type=PATH, help="Positions: run, time_s and one column per axis [mm].")
@click.option("--out", required=True, type=PATH, help="File to write, .csv or .parquet.")
@click.option("--uncertainty", is_flag=True, help="Add the standard deviations dx_std_um, dy_std_um, dz_std_um.")
def predict(bundle: Path, telemetry: Path, positions: Path, out: Path, uncertainty: bool) -> None:
    """Write the tip's predicted deviation at positions and times, from temperatures alone.

    The network runs over each run from its first sample. A bundle trained on changes since the start of a run
    (datum "run-start") gives changes since then; an absolute one gives thermal and geometric deviation together.
    The output has run, time_s, the axes, dx_um, dy_um, dz_um. With --uncertainty it also has the standard deviations
    of the last three, of the thermal part alone; 1.96 times them hold 95 % of the deviations.
    """
    import numpy as np

    from model.bundle import load_bundle
    from model.chain import Chain
    from model.exceptions import BundleError, DataError
    from model.positions import read_positions
    from model.predictor import Predictor
    from model.progress import track
    from model.tables import write_table
    from model.telemetry import read_telemetry
    from model.terms import UM

    loaded = load_bundle(bundle)
    predictor = Predictor(loaded)
    if uncertainty and predictor.uncertainty is None:
        raise BundleError(f"bundle '{bundle}' must say how far it may be off for --uncertainty; train it again")
    runs, _ = read_telemetry(telemetry, predictor.sensors, predictor.channels)
    table, q = read_positions(positions, loaded.machine, required=("run", "time_s"))
    run_of, time_s = table.text["run"], table.numbers["time_s"]
    chain = Chain(loaded.machine)
    found, std = np.empty((len(table), 3)), np.zeros((len(table), 3))
    for name in track(list(dict.fromkeys(run_of.tolist())), "predicting"):
        rows = np.flatnonzero(run_of == name)
        if name not in runs:
            raise DataError(f"run '{name}' of '{positions}' must be in '{telemetry}', got {', '.join(runs)}")
        run = runs[name]
        early = rows[~(time_s[rows] >= run.time_s[0])]
        if len(early):
            raise DataError(
                f"times in run '{name}' of '{positions}' must not lie before its telemetry, which starts at "
                f"{run.time_s[0]:g} s, got {time_s[early[0]]:g} in row {early[0] + 1}"
            )
        late = rows[~(time_s[rows] <= run.time_s[-1])]
        if len(late):
            raise DataError(
                f"times in run '{name}' of '{positions}' must not lie after its telemetry, which ends at "
                f"{run.time_s[-1]:g} s, got {time_s[late[0]]:g} in row {late[0] + 1}"
            )
        states = predictor.states(run)
        followed = np.array([state.coefficients for state in states])
        if predictor.datum == "run-start":
            followed = followed - followed[0]
        at = np.stack([np.interp(time_s[rows], run.time_s, c) for c in followed.T], axis=1)
        e = predictor.fields.evaluate(at, q[rows])
        if predictor.datum == "absolute":
            e = e + loaded.geometry.evaluate(q[rows])
        if uncertainty and predictor.uncertainty is not None:
            size = np.interp(time_s[rows], run.time_s, predictor.spread(states))
            std[rows] = predictor.uncertainty.tip(q[rows], size)
        found[rows] = chain.deviation(q[rows], e).position_mm / UM
    axes = {a: q[:, i] for i, a in enumerate(loaded.machine.axis_names)}
    deviation = {f"d{a}_um": found[:, i] for i, a in enumerate("xyz")}
    unsure = {f"d{a}_std_um": std[:, i] for i, a in enumerate("xyz")} if uncertainty else {}
    write_table(out, {"run": run_of, "time_s": time_s, **axes, **deviation, **unsure})
    click.echo(f"{len(table)} positions written to {out}")
