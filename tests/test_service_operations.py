"""The files for operators: the dashboard, the compose file, the image."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families
from service_client import NOON, Service, sample

from service.settings import Settings

ROOT = Path(__file__).parents[1]
DASHBOARD = json.loads((ROOT / "grafana" / "thermotrue.json").read_text(encoding="utf-8"))
COMPOSE = yaml.safe_load((ROOT / "compose.yaml").read_text(encoding="utf-8"))
DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")
ANY: set[str] = set()
QUERIES = [target["expr"] for panel in DASHBOARD["panels"] for target in panel["targets"]]


def exported(service: Service) -> dict[str, set[str]]:
    """Return the label names of every metric that a service which has been at work exports."""
    service.warm()
    service.telemetry(sample(NOON + 1.0, 30.0, column=None))
    service.compensate()
    found: dict[str, set[str]] = {}
    for family in text_string_to_metric_families(service.client.get("/metrics").text):
        if not family.samples:  # what only weeks of probing bring about; its labels are not known here
            found[family.name] = ANY
        for line in family.samples:
            found.setdefault(line.name, set()).update(line.labels)
    return found


def test_the_dashboard_asks_only_for_what_is_exported(service: Service) -> None:
    known = exported(service)
    assert QUERIES
    for query in QUERIES:
        asked = re.findall(r"\b(?:thermotrue|process)_\w+", query)
        assert asked, query
        for name in asked:
            assert name in known, query
        labels = set(re.findall(r"(\w+)=~?\"", query))
        labels |= {label for by in re.findall(r"by \(([^)]*)\)", query) for label in by.split(", ")}
        for name in asked:
            assert known[name] is ANY or labels <= known[name], query


def test_the_dashboard_shows_all_that_is_exported_of_machines(service: Service) -> None:
    shown = " ".join(QUERIES)
    for name in exported(service):
        if name.startswith("thermotrue_") and not name.endswith(("_created", "_sum")):
            assert name in shown, f"{name} is on no panel of grafana/thermotrue.json"


def test_panels_have_ids_of_their_own_and_do_not_overlap() -> None:
    panels = DASHBOARD["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels)
    cells = [
        (x, y)
        for p in (panel["gridPos"] for panel in panels)
        for x in range(p["x"], p["x"] + p["w"])
        for y in range(p["y"], p["y"] + p["h"])
    ]
    assert len(set(cells)) == len(cells)
    assert max(x for x, _ in cells) < 24


@pytest.mark.parametrize("name", COMPOSE["services"])
def test_what_compose_starts_is_shut_in(name: str) -> None:
    service: dict[str, Any] = COMPOSE["services"][name]
    assert service["read_only"] is True
    assert "no-new-privileges:true" in service["security_opt"]
    assert "." not in service["image"].split("/")[0].split(":")[0]
    for port in service.get("ports", ()):
        assert port.startswith("127.0.0.1:")
    for volume in service["volumes"]:
        assert volume.split(":")[0] in COMPOSE["volumes"]
    for config in service.get("configs", ()):
        assert (ROOT / COMPOSE["configs"][config["source"]]["file"]).exists()
    for other in service.get("depends_on", ()):
        assert other in COMPOSE["services"]


def test_compose_and_the_image_set_settings_that_exist() -> None:
    known = {f"THERMOTRUE_{name.upper()}" for name in Settings.model_fields}
    named = set(COMPOSE["services"]["thermotrue"]["environment"])
    named |= set(re.findall(r"(THERMOTRUE_\w+)=", DOCKERFILE))
    assert named
    assert named <= known


def test_prometheus_reads_the_service_with_a_key_from_a_file() -> None:
    [job] = yaml.safe_load((ROOT / "prometheus" / "prometheus.yaml").read_text(encoding="utf-8"))["scrape_configs"]
    assert job["static_configs"] == [{"targets": ["thermotrue:8000"]}]
    [secret] = COMPOSE["services"]["prometheus"]["secrets"]
    assert job["authorization"] == {"type": "Bearer", "credentials_file": f"/run/secrets/{secret}"}
    assert COMPOSE["secrets"][secret]["file"] in (ROOT / "compose.yaml").read_text().split("services:")[0]
    assert f"/{COMPOSE['secrets'][secret]['file']}" in (ROOT / ".gitignore").read_text().splitlines()


def test_the_image_starts_as_compose_starts_it() -> None:
    [command] = re.findall(r"^CMD (\[.*\])$", DOCKERFILE, re.MULTILINE)
    assert json.loads(command) == COMPOSE["services"]["thermotrue"]["command"]
    assert "VOLUME /data" in DOCKERFILE
    assert "/healthz" in DOCKERFILE
