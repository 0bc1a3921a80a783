"""The compiled path is compared with the plain chain before the service starts."""

from dataclasses import replace

import numpy as np
import pytest

from model.compensation import compensate
from model.exceptions import ComputeError
from service import self_test


def test_the_compiled_path_is_right_here() -> None:
    self_test.check_compiled_path()


@pytest.mark.parametrize("wrong", [2e-6, np.nan])
def test_a_path_that_is_wrong_by_two_nanometres_at_one_position_is_found(
    monkeypatch: pytest.MonkeyPatch, wrong: float
) -> None:
    def spoilt(*arguments: object) -> object:
        found = compensate(*arguments)  # type: ignore[arg-type]
        corrected = found.corrected.copy()
        corrected[70, 2] += wrong
        return replace(found, corrected=corrected)

    monkeypatch.setattr(self_test, "compensate", spoilt)
    with pytest.raises(ComputeError, match=r"^the compiled path must put the tip within 1e-06 mm"):
        self_test.check_compiled_path()
