import os
from collections.abc import Iterator

import pytest
from service_client import Service, serving

import model.kernel  # noqa: F401 (compiled here where it was not, so that no test waits for it or reads that it is)

os.environ.setdefault("THERMOTRUE_DATABASE", "sqlite://")  # no test, nor a process it starts, keeps anything at home


@pytest.fixture
def service() -> Iterator[Service]:
    """The tiny machine, served in the test's own process."""
    with serving() as running:
        yield running


@pytest.fixture
def replayed() -> Iterator[Service]:
    """The same, with the times in requests as its clock."""
    with serving(replay=True) as running:
        yield running
