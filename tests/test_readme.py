"""The README is tested: its figures, commands, files and the call it tells people to paste."""

import json
import re
from importlib.metadata import entry_points
from pathlib import Path

import click
import pytest
from fastapi.testclient import TestClient

from model.bundle import load_bundle
from service.app import create_app
from service.cli import greeting
from service.settings import Settings
from training.evaluation import NETWORK, NO_COMPENSATION, RIDGE

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = tuple(sorted(page.stem for page in (ROOT / "docs").glob("*.md")))
BUNDLE = load_bundle(ROOT / "demo" / "vmc3")


def commands() -> dict[str, click.Command]:
    return {e.name: e.load() for e in entry_points(group="thermotrue.commands")}


def test_every_command_is_listed_and_every_listed_one_exists() -> None:
    assert set(re.findall(r"^\| `thermotrue (\w+)`", README, re.MULTILINE)) == set(commands())


def test_the_commands_in_blocks_have_the_options_they_are_given() -> None:
    blocks = "\n".join(re.findall(r"```sh\n(.*?)```", README, re.DOTALL))
    lines = re.findall(r"^thermotrue (\w+)(.*)$", blocks, re.MULTILINE)
    assert lines
    for name, rest in lines:
        known = {option for p in commands()[name].params for option in p.opts}
        assert set(re.findall(r"--[\w-]+", rest)) <= known


def test_the_curl_line_is_the_one_that_make_run_prints() -> None:
    line = next(row for row in README.splitlines() if row.startswith("curl"))
    assert line in greeting([BUNDLE], "http://127.0.0.1:8000")


def test_the_answer_shown_is_the_demos() -> None:
    text = re.search(r"```json\n(.*?)```", README, re.DOTALL)
    assert text is not None
    shown = json.loads(text[1])
    answer = TestClient(create_app([BUNDLE], Settings()))
    with answer as client:
        reply = client.post("/v1/machines/vmc3/compensate", json={"positions": [{"X": 400.0, "Y": 250.0, "Z": 250.0}]})
    came = reply.json()
    assert shown.keys() == came.keys()
    assert (shown["status"], shown["warnings"]) == (came["status"], came["warnings"])
    assert re.fullmatch(r"[0-9a-f]{12}", shown["model"])  # rounding differs between processors, and with it the version
    for what in ("corrected", "correction"):
        assert shown["points"][0][what] == pytest.approx(came["points"][0][what], abs=1e-9)


def test_the_demos_scores_are_those_of_its_manifest() -> None:
    for name in (NO_COMPENSATION, RIDGE, NETWORK):
        score = BUNDLE.manifest.test["scores"][name]
        assert f"| {name} | {score['rms_um']:.2f} | {score['share']:.1%} | {score['worst_um']:.1f} |" in README


@pytest.mark.parametrize("page", ["README.md", *(f"docs/{name}.md" for name in PAGES)])
def test_links_lead_somewhere(page: str) -> None:
    folder = (ROOT / page).parent
    for target in re.findall(r"\]\(([^)#]+)\)", (ROOT / page).read_text(encoding="utf-8")):
        assert target.startswith("http") or (folder / target).exists(), target


def test_targets_named_exist() -> None:
    makefile = (ROOT / "Makefile").read_text()
    for target in set(re.findall(r"(?:`|^)make (\w+)", README, re.MULTILINE)):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


def test_the_demo_bundle_is_small_enough_to_commit() -> None:
    assert sum(f.stat().st_size for f in BUNDLE.path.iterdir()) < 1_000_000
