"""A service that is restarted or killed goes on as its twin that never stopped."""

import json
import logging
import random
import signal
import sqlite3
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bundles import resealed
from fastapi.testclient import TestClient
from service_client import MIDDLE, NOON, TINY, Service, correction_um, sample
from sqlalchemy import select, update
from store_databases import database

from model.bundle import GEOMETRY, Bundle, load_bundle, parse_bundle, read_files
from model.predictor import ThermalState
from service.app import create_app
from service.machine_state import MachineState
from service.restore import rebuild, stored_samples
from service.settings import Settings
from service.snapshot import SnapshotError, from_json, to_json
from service.store.store import open_store
from service.store.tables import snapshots, telemetry
from service.thermal import Zero

CORNER = {"X": 700.0, "Y": 80.0, "Z": 450.0}
SAME_UM = 0.001
"""How far a restarted service may be from one that never stopped [µm]."""


@contextmanager
def running(where: Path | str, clock: list[float], bundle: Bundle | None = None) -> Iterator[Service]:
    url = where if isinstance(where, str) else f"sqlite:///{where}"
    app = create_app(
        [bundle or load_bundle(TINY)],
        Settings(database=url),
        clock=lambda: clock[0],
        steady=lambda: clock[0],
    )
    with TestClient(app) as client:
        yield Service(client, clock)


def as_killed(path: Path, service: Service) -> Path:
    """Return a copy of the database as a kill would leave it now: all that is durable, and nothing else."""
    service.client.post("/v1/machines/tiny/telemetry", json={"samples": [sample(1.0)]})  # waits for all before it
    copy = path.with_name("killed.db")
    with closing(sqlite3.connect(path)) as source, closing(sqlite3.connect(copy)) as target:
        source.backup(target)
    return copy


def served_um(service: Service) -> np.ndarray[Any, np.dtype[np.float64]]:
    return correction_um(service.compensate([MIDDLE, CORNER], tool={"length_mm": 120.0}))


def assert_same_memory(a: MachineState, b: MachineState) -> None:
    assert a.thermal is not None
    assert b.thermal is not None
    one, other = a.thermal.memory(), b.thermal.memory()
    assert one.state is not None
    assert other.state is not None
    for field in fields(ThermalState):
        np.testing.assert_array_equal(getattr(one.state, field.name), getattr(other.state, field.name))
    np.testing.assert_array_equal(one.channels, other.channels)
    for name in ("tracks", "faults", "held", "failure", "heard_s"):
        assert getattr(one, name) == getattr(other, name), name
    for zero, same in ((one.run_start, other.run_start), (one.zero, other.zero)):
        assert_same_zero(zero, same)


def assert_same_zero(zero: Zero, same: Zero) -> None:
    assert (zero.kind, zero.time_s) == (same.kind, same.time_s)
    if zero.errors is not None:
        assert same.errors is not None
        rows = [(t, p, v) for t, p, v in same.errors.rows() if v]
        assert [(t, p, v) for t, p, v in zero.errors.rows() if v] == rows


class Day:
    """A day in a shop: random and repeatable calls."""

    def __init__(self, seed: int, clock: list[float]) -> None:
        self.rng = random.Random(seed)  # noqa: S311 (a day, not a secret)
        self.clock, self.degC = clock, 22.0

    def call(self, *services: Service) -> None:
        """Let a few minutes pass, and make one call to each of the services."""
        rng = self.rng
        self.clock[0] += rng.choice([0.5, 5.0, 60.0])
        what = rng.choice(["telemetry"] * 6 + ["compensate"] * 6 + ["with temperatures", "datum", "clear"])
        if what in ("telemetry", "with temperatures"):
            self.degC += rng.uniform(-0.2, 0.6)
            spindle = rng.choice([self.degC + 2.0, self.degC + 2.0, None, 500.0])
            new = sample(self.clock[0], self.degC, rng.choice([0.0, 3000.0]), spindle=spindle)
            if rng.random() < 0.3:
                del new["channels"]
        for service in services:
            if what == "telemetry":
                service.telemetry(new)
            elif what == "with temperatures":
                service.compensate(**new)
            elif what == "compensate":
                served_um(service)
            elif what == "datum" and service.get()["telemetry_time"]:
                service.post("datum")
            elif what == "clear":
                service.client.delete("/v1/machines/tiny/datum")


@pytest.mark.parametrize("seed", range(4))
def test_a_killed_service_goes_on_as_the_one_that_was_not_killed(seed: int, tmp_path: Path) -> None:
    clock = [NOON]
    day = Day(seed, clock)
    path = tmp_path / "t.db"
    with running(path, clock) as alive:
        for _ in range(80 + 7 * seed):
            day.call(alive)
        before = served_um(alive)
        alive.telemetry(sample(clock[0] + 0.1, day.degC))
        killed = as_killed(path, alive)
        with running(killed, clock) as restarted:
            assert_same_memory(alive.state, restarted.state)
            after = served_um(restarted)
            assert np.abs(after - before).max() <= 1.0
            for _ in range(20):
                clock[0] += 60.0
                for service in (alive, restarted):
                    service.telemetry(sample(clock[0], day.degC))
                reached = [served_um(s) for s in (alive, restarted)]
            np.testing.assert_allclose(reached[1], reached[0], atol=SAME_UM)
            assert not alive.compensate()["points"][0]["limited"]
            for _ in range(20):
                day.call(alive, restarted)
            assert_same_memory(alive.state, restarted.state)


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_restart_in_the_middle_of_a_movement_moves_on_as_its_twin(kind: str, tmp_path: Path) -> None:
    """The served map, its time and the datum survive: the correction goes on at its rate from where it was."""
    clock = [NOON]
    with database(kind, tmp_path) as url, running("sqlite://", clock) as twin:
        with running(url, clock) as first:
            for service in (twin, first):
                service.warm(20.0, end=NOON - 7200.0)
                served_um(service)
                service.post("datum")
                service.telemetry(*(sample(NOON - 7200.0 + 600.0 * n, 20.0 + n) for n in range(1, 13)))
                served_um(service)
            clock[0] += 5.0
            for service in (twin, first):
                moving = service.compensate([MIDDLE, CORNER], tool={"length_mm": 120.0})
                assert moving["points"][0]["limited"]
        clock[0] += 2.0
        with running(url, clock) as restarted:
            for _ in range(30):
                clock[0] += 1.0
                np.testing.assert_allclose(served_um(restarted), served_um(twin), atol=SAME_UM)
            assert restarted.get()["datum"] == twin.get()["datum"]
            assert restarted.get()["datum"]["kind"] == "set"


def test_after_another_start_of_the_computer_no_time_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The steady clock starts anew there, so nobody knows how long it was."""
    clock = [NOON]
    with running(tmp_path / "t.db", clock) as first:
        first.warm(20.0, end=NOON - 60.0)
        before = served_um(first)
        first.telemetry(sample(NOON, 22.0))
    monkeypatch.setattr("service.machine_state.boot_id", lambda: "another")
    clock[0] += 100.0
    with running(tmp_path / "t.db", clock) as restarted:
        np.testing.assert_allclose(served_um(restarted), before, atol=SAME_UM)
        clock[0] += 1.0
        assert 0.0 < np.abs(served_um(restarted) - before).max() <= 1.0


def test_a_power_loss_in_the_middle_of_a_movement_costs_a_micrometre_at_most(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was served last is stored as it moves, so the machine does not go back to where it was at the start."""
    clock = [NOON]
    path = tmp_path / "t.db"
    with running(path, clock) as alive:
        alive.warm(20.0, end=NOON - 3600.0)
        start = served_um(alive)
        alive.telemetry(*(sample(NOON - 3600.0 + 300.0 * n, 20.0 + n) for n in range(1, 13)))
        for _ in range(20):
            clock[0] += 0.3
            before = served_um(alive)
        assert np.abs(before - start).max() > 3.0
        killed = as_killed(path, alive)
    monkeypatch.setattr("service.machine_state.boot_id", lambda: "another")
    clock[0] += 100.0
    with running(killed, clock) as restarted:
        assert np.abs(served_um(restarted) - before).max() <= 1.0


@pytest.mark.parametrize("warmer_K", [0.0, 0.05, 2.0])
def test_a_kill_long_after_the_last_snapshot_makes_no_jump(tmp_path: Path, warmer_K: float) -> None:
    """The same map may have been served for long after its snapshot: that time is used up, and counts for no way."""
    clock = [NOON]
    path = tmp_path / "t.db"
    with running(path, clock) as alive:
        alive.warm(20.0, end=NOON - 7200.0)
        served_um(alive)
        alive.telemetry(*(sample(NOON - 7200.0 + 300.0 * n, 20.0 + warmer_K) for n in range(1, 12)))
        for _ in range(40):  # first on its way, and then there
            clock[0] += 0.6
            served_um(alive)
        for _ in range(28):  # as long as until the next snapshot is due
            clock[0] += 1.0
            before = served_um(alive)
        alive.telemetry(*(sample(NOON - 3600.0 + 300.0 * n, 20.0 + n) for n in range(1, 13)))
        killed = as_killed(path, alive)
        clock[0] += 1.0
        with running(killed, clock) as restarted:
            after = served_um(restarted)
            assert restarted.compensate()["points"][0]["limited"]
            assert np.abs(after - before).max() <= 2.0  # a second's way, and what was forgotten
            clock[0] += 60.0
            np.testing.assert_allclose(served_um(restarted), served_um(alive), atol=SAME_UM)


def other_bundle(growth_um: float = 5.0) -> Bundle:
    """Return another version of the tiny machine's bundle."""
    files = read_files(TINY)
    return parse_bundle(resealed({**files, GEOMETRY: files[GEOMETRY] + f"EZ0T,,{growth_um}\n".encode()}), "other")


def test_another_model_is_led_through_the_telemetry_and_moves_at_the_rate(tmp_path: Path) -> None:
    """The thermal state is as though the new model had been there all the time, and the datum is set where it was."""
    clock = [NOON]
    other = other_bundle()

    def history(service: Service) -> None:
        service.warm(20.0, hours=1, end=NOON - 7200.0)
        served_um(service)
        service.post("datum")
        service.telemetry(*(sample(NOON - 7200.0 + 600.0 * n, 20.0 + 0.5 * n) for n in range(1, 13)))

    with running(tmp_path / "twin.db", clock, other) as twin:
        history(twin)
        with running(tmp_path / "t.db", clock) as first:
            history(first)
            clock[0] += 3600.0
            before = served_um(first)
        clock[0] += 600.0
        with running(tmp_path / "t.db", clock, other) as restarted:
            assert_same_memory(restarted.state, twin.state)
            np.testing.assert_allclose(served_um(restarted), before, atol=SAME_UM)
            clock[0] += 1.0
            assert 0.0 < np.abs(served_um(restarted) - before).max() <= 1.0
            clock[0] += 3600.0
            for service in (restarted, twin):
                service.telemetry(sample(clock[0], 26.0))
                served_um(service)
            clock[0] += 60.0
            np.testing.assert_allclose(served_um(restarted), served_um(twin), atol=SAME_UM)


def test_a_datum_that_telemetry_does_not_reach_stays_what_it_was(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    clock = [NOON]
    with running(tmp_path / "t.db", clock) as first:
        first.warm(20.0, end=NOON - 7200.0)
        first.post("datum")
        zero = first.state.zero
        first.warm(24.0)
    with open_store(f"sqlite:///{tmp_path / 't.db'}") as store, store.engine.begin() as connection:
        connection.execute(telemetry.delete().where(telemetry.c.time_s <= NOON - 7200.0))
    with running(tmp_path / "t.db", clock, other_bundle()) as restarted:
        assert restarted.state.zero.modes is None
        assert_same_zero(restarted.state.zero, zero)
    [told] = [r for r in caplog.records if r.message == "not rebuilt in full"]
    assert told.reason.startswith("telemetry must reach back to the datum of 2027-01-15T06:00:00Z")  # type: ignore[attr-defined]


@pytest.mark.parametrize("harm", ["cut", "terms", "number", "format", "shape"])
def test_a_damaged_snapshot_is_told_in_one_sentence_and_telemetry_does(
    harm: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    clock = [NOON]
    path = tmp_path / "t.db"
    with running(path, clock) as first:
        first.warm(26.0)
        before = served_um(first)
        first.post("datum")
        thermal = first.state.thermal
    with open_store(f"sqlite:///{path}") as store, store.engine.begin() as connection:
        text = str(connection.execute(select(snapshots.c.state)).scalar())
        content = json.loads(text)
        if harm == "cut":
            harmed = text[: len(text) // 2]
        else:
            if harm == "terms":
                content["served"]["errors"]["terms"].pop()
            elif harm == "number":
                content["memory"]["state"]["modes"][0] = float("nan")
            elif harm == "format":
                content["format"] = 99
            else:
                content["memory"]["state"]["modes"].append(1.0)
            harmed = json.dumps(content)
        connection.execute(update(snapshots).values(state=harmed))
    with running(path, clock) as restarted:
        assert thermal is not None
        assert thermal.state is not None
        assert restarted.state.thermal is not None
        assert restarted.state.thermal.state is not None
        np.testing.assert_array_equal(restarted.state.thermal.state.modes, thermal.state.modes)
        only_the_state = harm in ("number", "shape")  # then what was served and the datum are as they were
        assert restarted.state.zero.kind == ("set" if only_the_state else "absolute")
        np.testing.assert_allclose(served_um(restarted), before, atol=SAME_UM)
    [told] = [r for r in caplog.records if r.message == "snapshot not used"]
    assert told.levelno == logging.WARNING
    assert told.reason.startswith(("it must ", "it is damaged: ", "its thermal state must have finite"))  # type: ignore[attr-defined]


def test_a_snapshot_comes_back_bit_for_bit_and_no_damage_raises_anything_else(tmp_path: Path) -> None:
    clock = [NOON]
    day = Day(5, clock)
    with running(tmp_path / "t.db", clock) as service:
        for _ in range(60):
            day.call(service)
        text, machine = to_json(service.state.snapshot()), service.state.machine
    assert to_json(from_json(text, machine)) == text
    rng = random.Random(1)  # noqa: S311
    for _ in range(500):
        where = rng.randrange(len(text))
        harmed = text[:where] + rng.choice(['"', "}", "[", "1e999", "null", "-", "x", ""]) + text[where + 1 :]
        try:
            found = from_json(harmed, machine)
        except SnapshotError as problem:
            assert "\n" not in str(problem)  # noqa: PT017 (either outcome will do)
        else:
            to_json(found)


def test_of_much_telemetry_a_part_is_led_through_with_the_newest_and_the_datum(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.restore.NEWEST", 10)
    with open_store(f"sqlite:///{tmp_path / 't.db'}") as store:
        rows = [
            {"machine": m, "time_s": float(n), "received_s": 0.0, "sample": '{"temperatures":{},"channels":{}}'}
            for n in range(1000)
            for m in ("tiny", "other")
        ]
        with store.engine.begin() as connection:
            connection.execute(telemetry.insert(), rows)
        times = [s.time for s in stored_samples(store.engine, "tiny", 99.5, most=100, always=[431.0])]
        assert times == sorted(times)
        assert times[-10:] == [float(n) for n in range(990, 1000)]
        assert 431.0 in times
        assert 99.5 < times[0] < 120.0
        assert 90 <= len(times) <= 120
        assert max(np.diff(times)) <= 10.0
        assert len(list(stored_samples(store.engine, "tiny", 99.5))) == 900


def test_a_machine_without_history_starts_empty(tmp_path: Path) -> None:
    with open_store(f"sqlite:///{tmp_path / 't.db'}") as store:
        found = rebuild(load_bundle(TINY), None, store.engine)
    assert found.thermal.state is None
    assert found.warnings == ()


def test_the_real_service_is_killed_and_knows_what_it_acknowledged(tmp_path: Path) -> None:
    """Three lives of `thermotrue serve` on one folder, each killed right after its last answer."""
    command = [str(Path(sys.executable).with_name("thermotrue")), "serve", str(TINY), "--port", "0"]
    command += ["--database", f"sqlite:///{tmp_path / 'data' / 'thermotrue.db'}"]
    newest = None
    start_s = 1.7e9
    for life in range(3):
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        assert process.stdout is not None
        line = next(line for line in process.stdout if line.startswith("all calls: "))
        url = line.removeprefix("all calls: ").removesuffix("/docs\n") + "/v1/machines/tiny"
        found = _json(url)
        assert (found["telemetry_time"], found["datum"]["kind"]) == (newest, "set" if life else "absolute")
        for number in range(life + 3):
            time_s = start_s + 100.0 * life + number
            assert _json(f"{url}/telemetry", {"samples": [sample(time_s)]})["accepted"] == 1
        assert _json(f"{url}/datum", {})["datum"]["kind"] == "set"
        newest = _json(url)["telemetry_time"]
        process.send_signal(signal.SIGKILL)
        process.communicate()
    with open_store(f"sqlite:///{tmp_path / 'data' / 'thermotrue.db'}") as store, store.engine.connect() as connection:
        assert len(connection.execute(select(telemetry.c.id)).all()) == sum(life + 3 for life in range(3))


def _json(url: str, body: dict[str, Any] | None = None) -> Any:
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"content-type": "application/json"})  # noqa: S310 (our own address)
    with urllib.request.urlopen(request) as answer:  # noqa: S310
        return json.load(answer)
