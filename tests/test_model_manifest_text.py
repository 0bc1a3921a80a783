"""What equal machines share: the text of their manifests is read once, and means what it would mean alone."""

from pathlib import Path

import pytest

from model import manifest_text
from model.bundle import load_bundle
from model.exceptions import BundleError
from model.manifest_text import SPLIT, parsed_manifest
from model.shared_predictors import predictor_of

TINY = Path(__file__).parent / "data" / "tiny_bundle"
RAW = (TINY / "manifest.json").read_bytes()


def read(raw: bytes) -> object:
    """Return what a manifest means, or what is said of it."""
    try:
        return parsed_manifest(raw, "here", "manifest.json")
    except BundleError as problem:
        return str(problem)


@pytest.mark.parametrize(
    "edited",
    [
        RAW,
        RAW.replace(b'"machine": "', b'"machine": "other-', 1),
        RAW.replace(SPLIT, b'\n "training": {},' + SPLIT, 1),  # a key that comes again after the split
        RAW.replace(SPLIT, b'\n "network": null,' + SPLIT, 1),
        RAW.replace(SPLIT, b'\n "test": {"a": [' + SPLIT, 1),  # the rest is not on the level that it is on alone
        RAW.replace(SPLIT, b'\n "unknown": 1,' + SPLIT, 1),
        RAW.replace(b'"format_version": ', b'"format_version": 9', 1),
        RAW[: RAW.index(SPLIT)],
        RAW + b"}",
    ],
)
def test_what_was_read_before_changes_no_meaning(monkeypatch: pytest.MonkeyPatch, edited: bytes) -> None:
    read(RAW)
    found = read(edited)
    monkeypatch.setattr(manifest_text, "SPLIT", b"\0 stands nowhere")
    assert read(edited) == found


def test_equal_records_and_predictors_are_one() -> None:
    one, other = load_bundle(TINY), load_bundle(TINY)
    assert one.manifest.network is other.manifest.network
    held = predictor_of(one)
    assert predictor_of(other) is held
