"""Post an hour of warming up to the running demo machine and watch the correction follow.

Only Python's own library: this is what a gateway beside a controller has to do. `make warm` runs it.
"""

import argparse
import csv
import json
import urllib.error
import urllib.request
from datetime import datetime
from pathlib import Path

POSITION = {"X": 400.0, "Y": 250.0, "Z": 100.0}
CHANNELS = {"spindle_rpm", "feed_x", "feed_y", "feed_z", "coolant_on"}


def post(url: str, body: dict[str, object]) -> dict[str, object]:
    """Return the reply to a JSON body."""
    data = json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"Content-Type": "application/json"})  # noqa: S310 (our own server)
    with urllib.request.urlopen(request, timeout=30) as reply:  # noqa: S310
        answer: dict[str, object] = json.load(reply)
    return answer


def recorded_hour() -> list[dict[str, float]]:
    """Return the recorded samples, one a minute."""
    with Path(__file__).with_name("warm_up.csv").open(encoding="utf-8") as file:
        return [{name: float(cell) for name, cell in row.items()} for row in csv.DictReader(file)]


def sample(row: dict[str, float], begin_s: float) -> dict[str, object]:
    """Return a recorded row as a telemetry sample."""
    readings = {name: value for name, value in row.items() if name != "time_s"}
    return {
        "time": begin_s + row["time_s"],
        "temperatures": {name: value for name, value in readings.items() if name not in CHANNELS},
        "channels": {name: value for name, value in readings.items() if name in CHANNELS},
    }


def show(minute: float, reply: dict[str, object]) -> None:
    """Print the correction at one position."""
    point = reply["points"][0]  # type: ignore[index]
    deviation = "  ".join(f"{axis} {um:+7.2f}" for axis, um in point["deviation_um"].items())
    correction = "  ".join(f"{axis} {1000 * mm:+7.2f}" for axis, mm in point["correction"].items())
    print(f"{minute:>5.0f} min  {reply['status']:<14}  {deviation}    {correction}")


def main() -> None:
    """Play the hour, a sample a minute, as fast as the service answers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", default=8000, type=int)
    url = f"http://127.0.0.1:{parser.parse_args().port}/v1/machines/vmc3"
    try:
        # The machine's clock runs with the samples' times; it never goes back, so a second hour follows the first.
        clock = str(post(f"{url}/compensate", {"positions": [POSITION]})["time"])
        begin_s = datetime.fromisoformat(clock).timestamp() + 1.0
        print(f"{'':>9}  {'status':<14}  {'predicted deviation [µm]':<32}    correction [µm]")
        for row in recorded_hour():
            reply = post(f"{url}/compensate", {"positions": [POSITION], **sample(row, begin_s)})
            if row["time_s"] % 300 == 0:
                show(row["time_s"] / 60, reply)
    except urllib.error.URLError as problem:
        raise SystemExit(f"the demo machine does not answer at {url}: {problem}; start it with `make run`") from None


if __name__ == "__main__":
    main()
