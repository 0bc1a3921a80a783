"""The page at `/`: open, self-contained, and of nothing that the service does not say."""

import re
from importlib.resources import files

import pytest
from service_client import NOON, sample, serving

from service.page import FILES
from service.schemas import MachineReply, SensorInfo
from service.security_headers import PAGE_POLICY
from service.status import Status

SCRIPT = files("service.page").joinpath("page.js").read_text()


@pytest.mark.parametrize("path", FILES)
@pytest.mark.parametrize("keys", ["off", "required"])
def test_the_page_is_served_without_a_key_and_may_load_only_its_own_files(path: str, keys: str) -> None:
    with serving(keys=keys) as service:
        answer = service.client.get(path)
    assert answer.status_code == 200
    assert answer.headers["content-security-policy"] == PAGE_POLICY
    assert answer.headers["content-type"] == FILES[path][1]
    assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", answer.text)


def test_every_file_that_the_page_names_is_served() -> None:
    with serving() as service:
        named = re.findall(r'(?:href|src)="(/[^"]*)"', service.client.get("/").text)
        assert {"/page.css", "/page.js", "/docs"} <= set(named)
        assert all(service.client.get(path).status_code == 200 for path in named)


def test_the_script_reads_only_what_replies_have() -> None:
    read = set(re.findall(r"\bmachine\.(\w+)", SCRIPT))
    assert len(read) > 5
    assert read <= set(MachineReply.model_fields)
    sensor = set(re.findall(r"\bsensor\.(\w+)", SCRIPT))
    assert sensor
    assert sensor <= set(SensorInfo.model_fields)


def test_the_script_has_a_word_for_each_status() -> None:
    [said] = re.findall(r"const SAID = \{(.*?)\};", SCRIPT, flags=re.DOTALL)
    assert set(re.findall(r"(\w+): \"", said)) == {str(status) for status in Status}


def test_the_script_makes_no_markup_of_what_it_is_told() -> None:
    assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(", SCRIPT)


def test_what_the_page_shows_follows_the_service() -> None:
    with serving() as service:
        before = service.get()
        assert before["correction_um"] is None
        assert before["sensors"]["spindle"]["taken_degC"] is None
        service.telemetry(sample(NOON, 25.0))
        service.compensate()
        after = service.get()
        assert after["correction_um"] > 1.0
        assert after["remaining_um"] == 0.0
        assert after["reliability"] == 1.0
        assert after["sensors"]["spindle"]["taken_degC"] == pytest.approx(25.0)
