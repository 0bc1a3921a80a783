"""A week of probings, posted to the service: a machine that stays as it is, and one that shifts on the fifth day.

    python bench/drift.py [--bundle demo/vmc3] [--seed 1002] [--shift 15]

The machine warms up and cools down as its shifts make it, a sample every ten minutes; every four hours a probe touches
a sphere in the middle of the working volume, with a noise of 1 µm. After four days the tip of one of the two machines
stands off in Z, as after a collision. Prints what the service answers when it first says that a machine drifts, and at
the end. Ends with exit code 1 where it calls the first one drifting, or the second one not.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from pathlib import Path
from typing import Any

import numpy as np
from fastapi.testclient import TestClient
from fault_week import BEGIN_S, Week

from model.bundle import load_bundle
from service.app import create_app
from service.settings import Settings
from service.store.store import open_store

EVERY_S, PROBED_S, SHIFTED_S = 600.0, 4 * 3600.0, 4 * 86400.0
NOISE_UM = 1.0


def played(week: Week, shift_um: float) -> list[dict[str, Any]]:
    """Play the week and return the answers to its probings."""
    run, now, answers = week.run, [BEGIN_S], []
    middle = len(week.positions) // 2
    place = dict(zip(week.bundle.machine.axis_names, week.positions[middle].tolist(), strict=True))
    rng = np.random.default_rng(0)
    with open_store("sqlite://") as store:
        app = create_app([week.bundle], Settings(), clock=lambda: now[0], steady=lambda: now[0], store=store)
        with TestClient(app) as client:
            url = f"/v1/machines/{week.bundle.machine.name}"
            for j in np.flatnonzero(run.time_s % EVERY_S == 0.0):
                now[0] = BEGIN_S + float(run.time_s[j])
                temperatures = {name: float(v[j]) for name, v in run.sensors.items()}
                channels = {name: float(v[j]) for name, v in run.channels.items()}
                sample = {"time": now[0], "temperatures": temperatures, "channels": channels}
                client.post(f"{url}/telemetry", json={"samples": [sample]}).raise_for_status()
                if run.time_s[j] % PROBED_S or not j:
                    continue
                look = int(np.argmin(np.abs(run.terms_time_s - run.time_s[j])))
                deviation = week.truth_um[look, middle] + rng.normal(0.0, NOISE_UM, 3)
                deviation[2] += shift_um if run.time_s[j] > SHIFTED_S else 0.0
                measured = {"x": deviation[0], "y": deviation[1], "z": deviation[2]}
                body = {"measurements": [{"time": now[0], "position": place, "deviation_um": measured}]}
                answer = client.post(f"{url}/measurements", json=body)
                answer.raise_for_status()
                answers.append({"hours": run.time_s[j] / 3600.0, **answer.json()})
    return answers


def shown(answer: dict[str, Any]) -> str:
    """Return what matters of an answer, rounded."""
    kept = {key: answer[key] for key in ("hours", "status", "warnings", "drift", "measurements")}
    return json.dumps(json.loads(json.dumps(kept), parse_float=lambda text: round(float(text), 2)), indent=1)


def main() -> None:
    """Play both machines' weeks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bundle", type=Path, default=Path("demo/vmc3"))
    parser.add_argument("--seed", type=int, default=1002)
    parser.add_argument("--shift", type=float, default=15.0, help="In Z, from the fifth day on [µm].")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    week = Week.simulated(load_bundle(options.bundle), options.seed, 168.0)
    passed = True
    for shift_um in (0.0, options.shift):
        answers = played(week, shift_um)
        drifting = [a for a in answers if a["drift"]["drifting"]]
        print(f"a shift of {shift_um:g} µm: drifting in {len(drifting)} of {len(answers)} probings; at the end:")
        print(shown(answers[-1]))
        if drifting:
            print(f"drifting for the first time {drifting[0]['hours'] - SHIFTED_S / 3600.0:g} h after the shift:")
            print(shown(drifting[0]))
        passed = passed and bool(drifting) == (shift_um > 0.0)
    sys.exit(0 if passed else 1)


if __name__ == "__main__":
    main()
