"""Archives that are uploaded: what is no bundle is refused before it fills memory or names a path."""

import io
import zipfile
from collections.abc import Callable

import pytest
from bundles import packed
from service_client import TINY, TINY_URL, Service, assert_problem

from model.bundle import MACHINE, MAX_BYTES, NETWORK, read_files
from model.exceptions import BundleError
from service.models.archive import unpack

FILES = read_files(TINY)


def test_what_was_packed_is_unpacked() -> None:
    assert unpack(packed(FILES)) == unpack(packed(FILES, zipfile.ZIP_STORED)) == FILES


def archive(*entries: tuple[str, bytes], flags: int = 0) -> bytes:
    body = io.BytesIO()
    with zipfile.ZipFile(body, "w", zipfile.ZIP_DEFLATED) as made:
        for name, content in entries:
            made.writestr(name, content)
    raw = bytearray(body.getvalue())
    if flags:
        for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
            at = raw.find(signature)
            while at >= 0:
                raw[at + offset] |= flags
                at = raw.find(signature, at + 4)
    return bytes(raw)


def lying(name: str, size: int) -> bytes:
    """Return an archive whose entry unpacks to far more than it says."""
    raw = bytearray(archive((name, b"0" * size)))
    small = (1000).to_bytes(4, "little")
    for signature, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        at = raw.find(signature)
        raw[at + offset : at + offset + 4] = small
    return bytes(raw)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: b"", "the body must be a ZIP archive of a bundle's files, and cannot be read"),
        (lambda: b"PK\x05\x06" + bytes(18), "the archive must have the files machine.toml"),
        (lambda: packed(FILES)[:-40], "the body must be a ZIP archive"),
        (lambda: archive(("../machine.toml", b"")), "the archive must have only the files .*, got '../machine.toml'"),
        (lambda: archive(("/etc/passwd", b"")), "the archive must have only the files .*, got '/etc/passwd'"),
        (lambda: archive(("tiny/", b"")), "the archive must have only the files .*, got 'tiny/'"),
        (lambda: archive(("tiny/machine.toml", b"")), "the archive must have only the files .*, and no folders"),
        (lambda: archive((MACHINE, b"a"), (MACHINE, b"b")), "the archive must have machine.toml once, got it twice"),
        (lambda: archive((MACHINE, b"a"), flags=1), "machine.toml in the archive must be stored .*, got it encrypted"),
        (
            lambda: archive((MACHINE, b"0" * (MAX_BYTES[MACHINE] + 1))),
            "machine.toml in the archive must have at most 262144 bytes, got 262145",
        ),
        (lambda: lying(NETWORK, MAX_BYTES[NETWORK] + 1), "the body must be a ZIP archive .*, and cannot be read"),
        (lambda: packed(FILES, zipfile.ZIP_BZIP2), "machine.toml in the archive must be stored or deflated, got it"),
    ],
)
def test_archives_that_are_none_or_worse(service: Service, make: Callable[[], bytes], sentence: str) -> None:
    with pytest.raises(BundleError, match=f"^{sentence}"):
        unpack(make())
    answer = service.client.post(f"{TINY_URL}/models", content=make(), headers={"content-type": "application/zip"})
    assert_problem(answer, 422, "broken-bundle")
