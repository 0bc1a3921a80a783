"""What the service does beside requests: snapshots in time, retention, the audit trail; and where it keeps its data."""

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from service_client import NOON, TINY, TINY_URL, assert_problem, sample, serving
from sqlalchemy import func, insert, select
from store_databases import database

from model.bundle import load_bundle
from service import keeper
from service.app import create_app
from service.keeper import DAY_S, KEEP_AUDIT_DAYS, KEEP_MEASUREMENTS_DAYS, prune
from service.settings import Settings, read_settings
from service.store.store import Store, open_store
from service.store.tables import audit, measurements, snapshots, telemetry


def add(store: Store, table: Any, times: list[float], **more: Any) -> None:
    with store.engine.begin() as connection:
        connection.execute(insert(table), [{"time_s": t, **more} for t in times])


def times_of(store: Store, table: Any) -> list[float]:
    with store.engine.connect() as connection:
        return list(connection.execute(select(table.c.time_s).order_by(table.c.time_s)).scalars())


def fill(store: Store, snapshot_s: float | None) -> None:
    days = [NOON - n * DAY_S for n in range(100)]
    add(store, telemetry, days, machine="tiny", received_s=0.0, sample="{}")
    if snapshot_s is not None:
        add(store, snapshots, [snapshot_s], machine="tiny", saved_s=0.0, model="v", state="{}")


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_old_rows_go_and_all_that_a_restart_needs_stays(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(keeper, "PRUNE_ROWS", 7)  # in steps, as a large table
    monkeypatch.setattr(keeper, "PRUNE_PAUSE_S", 0.0)
    with database(kind, tmp_path) as url, open_store(url) as store:
        fill(store, NOON)
        far = NOON - max(KEEP_AUDIT_DAYS, KEEP_MEASUREMENTS_DAYS) * DAY_S - 1.0
        add(store, measurements, [far, NOON], machine="tiny", received_s=0.0, model="v", body="{}")
        add(store, audit, [far, NOON], who="me", machine=None, action="x", detail="{}")
        assert asyncio.run(prune(store, 30.0, NOON)) == 69 + 2
        assert times_of(store, telemetry) == [NOON - n * DAY_S for n in range(30, -1, -1)]
        assert times_of(store, measurements) == [NOON]
        assert times_of(store, audit) == [NOON]
        assert asyncio.run(prune(store, 30.0, NOON)) == 0


@pytest.mark.parametrize("snapshot_s", [NOON - 50 * DAY_S, None])
def test_no_clock_makes_it_remove_what_no_snapshot_has(snapshot_s: float | None, tmp_path: Path) -> None:
    """Years ahead, or with a machine that was off for long: what no snapshot has stays, and days before it."""
    with open_store(f"sqlite:///{tmp_path / 't.db'}") as store:
        fill(store, snapshot_s)
        asyncio.run(prune(store, 1.0, NOON + 3000 * DAY_S))
        kept = times_of(store, telemetry)
    assert len(kept) == (100 if snapshot_s is None else 52)


def test_snapshots_are_taken_while_telemetry_comes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keeper, "TICK_S", 0.01)
    path = tmp_path / "t.db"
    with serving(database=f"sqlite:///{path}", snapshot_every_s=30.0) as service:
        found = []
        for number in range(30):
            service.clock[0] = NOON + 6.0 * number
            service.telemetry(sample(service.clock[0]))
            service.client.portal.call(asyncio.sleep, 0.05)  # type: ignore[union-attr]
            found.append(snapshot_times(service.client.app.state.store))  # type: ignore[attr-defined]
    taken = {t for times in found for t in times}
    assert 4 <= len(taken) <= 8, "every 30 s of 180"
    with open_store(f"sqlite:///{path}") as store:
        assert snapshot_times(store) == [NOON + 6.0 * 29], "and one at the end"


def snapshot_times(store: Store) -> list[float]:
    return times_of(store, snapshots)


def test_an_idle_database_is_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keeper, "TICK_S", 0.01)
    path = tmp_path / "t.db"
    with serving(database=f"sqlite:///{path}") as service:
        assert service.client.get("/readyz").json() == {"status": "ready", "storage": "ok"}
        moved = path.rename(tmp_path / "elsewhere.db")
        for _ in range(300):
            if service.client.get("/readyz").status_code == 503:
                break
            service.client.portal.call(asyncio.sleep, 0.02)  # type: ignore[union-attr]
        assert_problem(service.client.get("/readyz"), 503, "storage-unavailable", "the database must take writes, and")
        moved.rename(path)


def test_the_audit_trail_tells_who_changed_what(tmp_path: Path) -> None:
    with serving(database=f"sqlite:///{tmp_path / 't.db'}") as service:
        service.telemetry(sample(NOON))
        service.post("datum")
        service.client.delete(f"{TINY_URL}/datum")
        reply = service.get("/audit", limit=2)
        assert [(e["who"], e["action"]) for e in reply["entries"]] == [
            ("anyone", "datum cleared"),
            ("anyone", "datum set"),
        ]
        assert reply["entries"][1]["detail"] == {"kind": "set", "time": "2027-01-15T08:00:00Z"}
        assert {e["machine"] for e in reply["entries"]} == {"tiny"}
        answer = service.client.get(f"{TINY_URL}/audit", params={"limit": 0})
        assert_problem(answer, 422, "invalid-request", "key 'limit' in the query")
    with serving(database=f"sqlite:///{tmp_path / 't.db'}") as service:
        actions = [e["action"] for e in service.get("/audit")["entries"]]
        assert actions[:2] == ["service started", "service stopped"]
        assert "service started" in actions[2:], "the first time, too"


def test_a_store_given_to_the_app_stays_open_when_it_ends(tmp_path: Path) -> None:
    with open_store(f"sqlite:///{tmp_path / 't.db'}") as store:
        with TestClient(create_app([load_bundle(TINY)], Settings(), store=store)):
            pass
        with store.engine.connect() as connection:
            assert connection.execute(select(func.count()).select_from(audit)).scalar()


def test_the_database_is_a_file_in_the_data_folder_or_memory_in_replay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("THERMOTRUE_DATABASE")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert read_settings().database_url == f"sqlite:///{tmp_path}/thermotrue/thermotrue.db"
    assert read_settings(data_dir=tmp_path / "x").database_url == f"sqlite:///{tmp_path}/x/thermotrue.db"
    assert read_settings(replay=True).database_url == "sqlite://"
    assert read_settings(replay=True, database="sqlite:////d/b").database_url == "sqlite:////d/b"
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert read_settings().data_dir == tmp_path / ".local" / "state" / "thermotrue"


def test_rows_are_json_that_other_programs_read(tmp_path: Path) -> None:
    path = tmp_path / "t.db"
    with serving(database=f"sqlite:///{path}") as service:
        service.telemetry(sample(NOON, 21.5, 1000.0, column=None))
    with open_store(f"sqlite:///{path}") as store, store.engine.connect() as connection:
        [row] = connection.execute(select(telemetry)).all()
    assert (row.machine, row.time_s) == ("tiny", NOON)
    assert json.loads(row.sample) == {
        "temperatures": {"spindle": 21.5, "column": None, "ambient": 21.5},
        "channels": {"spindle_rpm": 1000.0},
    }
