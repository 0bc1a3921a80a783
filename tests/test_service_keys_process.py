"""Keys and TLS as an operator meets them: commands, the greeting, the log."""

import http.client
import json
import re
import signal
import ssl
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from service_client import TINY
from test_service_process import THERMOTRUE, start
from test_service_settings import certificate

from model.bundle import load_bundle
from service.access.keys import KEY
from service.cli import _make_key, greeting
from service.cli_keys import keys


def run(*args: str) -> Result:
    return CliRunner().invoke(keys, args)


def test_keys_are_made_listed_and_revoked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("THERMOTRUE_DATABASE", raising=False)
    where = ("--data-dir", str(tmp_path))
    made = run("create", "mill 1", "--role", "gateway", *where)
    assert made.exit_code == 0, made.output
    [key] = made.stdout.splitlines()  # alone, so that a shell can take it over
    found = KEY.fullmatch(key)
    assert found is not None
    public, secret = found.groups()
    assert made.stderr == f"keep it: it is not shown again; id {public}, role gateway\n"
    other = json.loads(run("create", "prometheus", "--role", "viewer", "--json", *where).stdout)
    assert set(other) == {"key", "id", "name", "role", "created", "revoked"}
    assert run("revoke", public, *where).stdout == f"revoked {public}, 'mill 1'\n"
    listed = json.loads(run("list", "--json", *where).stdout)
    assert [(row["name"], row["role"], row["revoked"] is None) for row in listed] == [
        ("mill 1", "gateway", False),
        ("prometheus", "viewer", True),
    ]
    table = run("list", *where).stdout
    assert re.match(r"id +name +role +created +revoked\n", table)
    assert secret not in table
    assert secret.encode() not in (tmp_path / "thermotrue.db").read_bytes()
    assert (tmp_path / "thermotrue.db").stat().st_mode & 0o077 == 0


def test_a_wrong_call_gets_one_sentence(tmp_path: Path) -> None:
    where = ("--database", f"sqlite:///{tmp_path / 'a.db'}")
    assert str(run("create", "a", "--role", "root", *where).exception) == (
        "--role must be one of viewer, gateway, admin, got 'root'"
    )
    assert str(run("revoke", "a", *where).exception) == "there is no key in force with the id or name 'a'"
    assert str(run("list", "--database", "sqlite://").exception) == (
        "keys must be kept in a database that lasts, got one in memory; name it by --database"
    )
    assert "database must be sqlite:///FILE or postgresql://" in str(run("list", "--database", "mysql://a").exception)


class Secure:
    """Calls of a service over TLS, which is trusted by its certificate."""

    def __init__(self, port: int, cert: Path) -> None:
        self._port, self._context = port, ssl.create_default_context(cafile=str(cert))

    def get(self, path: str, key: str | None) -> tuple[int, Any]:
        connection = http.client.HTTPSConnection("127.0.0.1", self._port, context=self._context, timeout=10)
        try:
            connection.request("GET", path, headers={} if key is None else {"authorization": f"Bearer {key}"})
            answer = connection.getresponse()
            return answer.status, json.load(answer)
        finally:
            connection.close()


def test_a_service_with_keys_and_tls(tmp_path: Path) -> None:
    cert, private = certificate(tmp_path)
    database = f"sqlite:///{tmp_path / 'a.db'}"
    tls = ("--tls-cert", str(cert), "--tls-key", str(private))
    process, lines = start(
        str(TINY),
        "--port",
        "0",
        "--keys",
        "required",
        *tls,
        "--database",
        database,
        "--access-log",
        "--log-level",
        "debug",
    )
    try:
        [command] = [line.strip() for line in lines if "keys create" in line]
        assert command == f"KEY=$(thermotrue keys create my-gateway --role gateway --database {database})"
        made = subprocess.run(
            ["sh", "-c", command.replace("thermotrue keys", f"{THERMOTRUE} keys") + " && echo $KEY"],
            capture_output=True,
            text=True,
            check=True,
        )
        key = made.stdout.strip()
        assert KEY.fullmatch(key)
        [curl] = [line for line in lines if line.lstrip().startswith("curl ")]
        assert ' -H "authorization: Bearer $KEY" ' in curl
        address = lines[-1].removeprefix("all calls: ").removesuffix("/docs")
        assert address.startswith("https://127.0.0.1:")
        service = Secure(int(address.rsplit(":", 1)[1]), cert)
        assert service.get("/healthz", None)[0] == 200
        assert service.get("/v1/machines", None)[0] == 401
        began_s = time.monotonic()
        while service.get("/v1/machines", key)[0] != 200:
            assert time.monotonic() - began_s < 5
            time.sleep(0.1)
        # Where no key belongs.
        assert service.get(f"/v1/machines/{key}?key={key}", key)[0] == 404
        assert service.get("/v1/machines", key[:-1])[0] == 401
    finally:
        process.send_signal(signal.SIGTERM)
        _, log = process.communicate(timeout=20)
    assert process.returncode == 0
    secret = key.rsplit("_", 1)[1]
    assert secret not in log
    assert secret[:-1] not in log
    assert "tt_" in log  # the key's public part is there, so the line was
    assert "callers refused" in log


def test_the_greeting_says_where_anybody_is_let_in() -> None:
    bundle = load_bundle(TINY)
    closed = greeting([bundle], "http://127.0.0.1:8000", make_key="thermotrue keys create my-gateway --role gateway")
    assert "keys are off" not in closed
    opened = greeting([bundle], "http://192.0.2.1:8000", open_to_all=True)
    assert opened.startswith("keys are off: whoever reaches this address can steer the correction\n")
    assert "$KEY" not in opened


def test_a_databases_password_is_not_in_the_command_that_makes_a_key() -> None:
    options = {"data_dir": None, "database": "postgresql://me:hush@host/name"}
    assert "hush" not in _make_key(None, options)
    assert _make_key(Path("a b.toml"), options | {"database": None}).endswith("--role gateway --config 'a b.toml'")
