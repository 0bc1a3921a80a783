"""What others could not read, or could read otherwise, is no JSON here."""

import json

import pytest

from model.strict_json import strict_json


@pytest.mark.parametrize("text", ['{"a": "\\ud800"}', '{"\\uDFff": 1}', '["x\\udc00\\ud800"]', '"\\ud83d \\ude00"'])
def test_half_a_character_is_refused(text: str) -> None:
    """It would be kept, and then every answer that has it would fail."""
    json.loads(text)  # Python reads it
    with pytest.raises(ValueError, match="characters must be whole, got half a surrogate pair"):
        strict_json(text.encode())


@pytest.mark.parametrize("value", ["\U0001f600", "µ°", "\\ud800", "\ud7ff\ue000"])
def test_whole_characters_come_back(value: str) -> None:
    for ascii_only in (True, False):
        assert strict_json(json.dumps({"a": value}, ensure_ascii=ascii_only).encode()) == {"a": value}
