"""One record of settings: its sources, their order, and its documentation."""

import json
import re
import subprocess
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from test_service_process import refuse

from model.exceptions import InputError
from service.cli import serve
from service.cli_settings import settings as settings_command
from service.listen import check_host
from service.settings import CONFIG, PREFIX, Settings, option, read_settings, unknown_variables
from service.settings_table import hidden, rows, shown

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "service.md").read_text(encoding="utf-8")
EVERYWHERE = "0.0.0.0"  # noqa: S104 (named, not bound)


@pytest.fixture(autouse=True)
def plain_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (*(f"{PREFIX}{name.upper()}" for name in Settings.model_fields), CONFIG):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "service.toml"
    path.write_text('port = 1001\nlog_level = "debug"\nbundles = ["a", "b"]\naccess_log = true\n')
    return path


def test_options_come_before_the_environment_before_the_file(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert read_settings(config).port == 1001
    assert read_settings(config).bundles == (Path("a"), Path("b"))
    monkeypatch.setenv("THERMOTRUE_PORT", "1002")
    assert read_settings(config).port == 1002
    assert read_settings(config, port=1003).port == 1003
    monkeypatch.setenv("THERMOTRUE_CONFIG", str(config))
    assert read_settings().log_level == "debug"
    origins = {row.name: row.origin for row in rows(None, port=1003)}
    assert origins["port"] == "option --port"
    assert origins["log_level"] == f"file '{config}'"
    assert origins["host"] == "default"
    monkeypatch.setenv("thermotrue_host", "localhost")
    assert {row.name: (row.value, row.origin) for row in rows()}["host"] == (
        "localhost",
        "environment variable thermotrue_host",
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("prot = 1", r"unknown key 'prot' in settings file '.*'; did you mean 'port'\?"),
        ("[serve]\nport = 1", r"unknown key 'serve' in settings file"),
        ("port = ", r"settings file '.*' must be TOML"),
        ("port = 70000", r"key 'port' in the settings \(file '.*'\): input should be less than or equal to 65535"),
        ('keys = "maybe"', r"key 'keys' in the settings \(file '.*'\): input should be 'auto', 'required' or 'off'"),
        ("stale_after_s = nan", r"key 'stale_after_s' in the settings \(file '.*'\): input should be"),
    ],
)
def test_a_wrong_file_gets_one_sentence(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "service.toml"
    path.write_text(content)
    with pytest.raises(InputError, match=message):
        read_settings(path)


def test_a_missing_file_gets_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"settings file '.*none.toml' must be readable: no such file or directory"):
        read_settings(tmp_path / "none.toml")


def test_a_wrong_value_names_its_variable_or_option(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"key 'stale_after_s' in the settings \(option --stale-after\): input should"):
        read_settings(stale_after_s=0)
    monkeypatch.setenv("THERMOTRUE_PORT", "many")
    with pytest.raises(InputError, match=r"key 'port' in the settings \(environment variable THERMOTRUE_PORT\)"):
        read_settings()


def test_a_misspelt_variable_is_told_of() -> None:
    environment = {"THERMOTRUE_KEY": "required", "THERMOTRUE_PORT": "1", "THERMOTRUE_DEBUG": "1", "OTHER": "1"}
    [told] = unknown_variables(environment)
    assert told.startswith("unknown environment variable 'THERMOTRUE_KEY'; it is not used; did you mean")
    assert unknown_variables({}) == []


def test_every_setting_is_an_option_of_serve() -> None:
    def options(command: click.Command) -> dict[str, list[str]]:
        return {p.name or "": p.opts for p in command.params if isinstance(p, click.Option)}

    offered = options(serve)
    for name in Settings.model_fields:
        if name != "bundles":  # they are the arguments
            assert offered[name] == [option(name)]
    assert set(offered) == {*Settings.model_fields, "config"} - {"bundles"}
    assert set(options(settings_command)) == {*offered, "as_json"}


def test_every_setting_is_documented() -> None:
    [section] = re.findall(r"^## Settings\n(.*?)^## ", PAGE, re.MULTILINE | re.DOTALL)
    table = dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", section, re.MULTILINE))
    assert set(table) == set(Settings.model_fields)
    for name, field in Settings.model_fields.items():
        assert field.description
        default, meaning = table[name].split(" | ", 1)
        assert meaning == field.description
        if name == "data_dir":
            assert default == "`~/.local/state/thermotrue`"
        else:
            value = field.default if not isinstance(field.default, tuple) else list(field.default)
            assert default == f"`{shown(value)}`"


def test_the_command_prints_all_with_their_origins(config: Path) -> None:
    result = CliRunner().invoke(settings_command, ["--config", str(config), "--port", "99", "--json"])
    assert result.exit_code == 0, result.output
    table = {row["name"]: row for row in json.loads(result.stdout)}
    assert set(table) == set(Settings.model_fields)
    assert (table["port"]["value"], table["port"]["origin"]) == (99, "option --port")
    plain = CliRunner().invoke(settings_command, ["--config", str(config)])
    assert re.search(r"^port +1001  \(file '.*service.toml'\)$", plain.stdout, re.MULTILINE)
    for row in table.values():
        assert row["meaning"] in plain.stdout


# Text that no URL has around a password, and that cannot be there by chance.
@given(st.text("abcXYZ0189._~!$&'()*+,;=%-", min_size=12))
def test_a_databases_password_is_never_shown(password: str) -> None:
    for url in (f"postgresql://me:{password}@host:5432/name", f"postgresql+psycopg://me:{password}@/name?host=/run"):
        assert password not in hidden(url)
        assert "me:***@" in hidden(url)
    table = {row.name: row.value for row in rows(None, database=f"postgresql://me:{password}@host/name")}
    assert table["database"] == "postgresql://me:***@host/name"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"host": EVERYWHERE}, r"TLS must be on beyond loopback, on '0.0.0.0', got no certificate, and keys would"),
        ({"host": EVERYWHERE, "keys": "off"}, r"keys must be required beyond loopback, on '0.0.0.0', got keys 'off'"),
        (
            {"host": "mill.local", "keys": "off", "allow_plain_http": True},
            r"keys must be required beyond loopback, on 'mill.local', got keys 'off'",
        ),
        (
            {"host": EVERYWHERE, "allow_plain_http": True, "replay": True, "database": None},
            r"keys must be kept in a database that lasts beyond loopback, on '0.0.0.0', got one in memory; give",
        ),
        ({"tls_cert": Path("a.pem")}, r"--tls-cert and --tls-key must be given together, got --tls-cert alone; add"),
        ({"tls_key": Path("a.pem")}, r"--tls-cert and --tls-key must be given together, got --tls-key alone; add"),
        (
            {"tls_cert": Path("none.pem"), "tls_key": Path("none.pem")},
            r"--tls-cert must be a readable file, got 'none.pem': no such file",
        ),
        (
            {"tls_cert": ROOT / "LICENSE", "tls_key": ROOT / "LICENSE"},
            r"--tls-cert and --tls-key must be a PEM certificate and its key, got '.*LICENSE' and '.*LICENSE': ",
        ),
    ],
)
def test_what_would_leave_the_service_open_needs_a_word(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        check_host(Settings(**{"database": "sqlite:///kept.db"} | settings))


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"keys": "off"},
        {"host": "localhost", "keys": "off"},
        {"host": "::1", "replay": True, "database": None},
        {"host": EVERYWHERE, "allow_plain_http": True},
        {"host": EVERYWHERE, "allow_plain_http": True, "keys": "off", "allow_open": True},
        {"host": EVERYWHERE, "allow_plain_http": True, "keys": "off", "allow_open": True, "replay": True},
    ],
)
def test_what_is_closed_or_meant_to_be_open_starts(settings: dict[str, Any]) -> None:
    check_host(Settings(**{"database": "sqlite:///kept.db"} | settings))


def test_an_encrypted_key_is_refused_without_asking_for_its_password(tmp_path: Path) -> None:
    cert, key = certificate(tmp_path, "-passout", "pass:secret")
    line = refuse(str(ROOT / "tests/data/tiny_bundle"), "--port", "0", "--tls-cert", str(cert), "--tls-key", str(key))
    assert line.startswith("thermotrue: --tls-key must not be encrypted, got '")


def certificate(folder: Path, *more: str) -> tuple[Path, Path]:
    """Make a certificate for this computer."""
    cert, key = folder / "cert.pem", folder / "key.pem"
    made = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-subj", "/CN=localhost", "-days", "2"]
    made += ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(cert)]
    subprocess.run([*made, *(more or ["-nodes"])], check=True, capture_output=True)
    return cert, key
