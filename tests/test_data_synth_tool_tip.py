import numpy as np
import pytest

from data_synth.dataset import make_dataset
from data_synth.machines import open_shop
from data_synth.probe import NOISE_UM, TOUCHES
from model.chain import Chain
from model.error_map import ErrorMap
from model.error_tables import read_error_table
from model.tables import read_table

MACHINES = ("vmc3", "hmc4")


@pytest.fixture(scope="module", params=MACHINES)
def made(request, tmp_path_factory):
    """A data set with touches, its machine, and the touches less what the exact chain makes of its own tables."""
    out = tmp_path_factory.mktemp("tip") / "data"
    shop = open_shop(request.param)
    make_dataset(shop, 2, 3.0, 4, out, tool_tip=True, pictures=False)
    machine = shop.machine
    tip = read_table(out / "tool_tip.parquet")
    terms = read_table(out / "error_terms.parquet", text=("run", "term"))
    cold = ErrorMap.from_rows(machine, read_error_table(out / "geometry.csv"))
    measured = np.column_stack([tip.numbers[f"d{axis}_um"] for axis in "xyz"])
    q = np.column_stack([tip.numbers[axis] for axis in machine.axis_names])
    expected = np.zeros_like(measured)
    chain = Chain(machine)
    for run in np.unique(tip.text["run"]):
        for time_s in np.unique(tip.numbers["time_s"]):
            here = (tip.text["run"] == run) & (tip.numbers["time_s"] == time_s)
            now = (terms.text["run"] == run) & (terms.numbers["time_s"] == time_s)
            rows = zip(
                terms.text["term"][now].tolist(),
                [None if np.isnan(p) else float(p) for p in terms.numbers["position"][now]],
                terms.numbers["value"][now].tolist(),
                strict=True,
            )
            hot = ErrorMap.from_rows(machine, rows)
            expected[here] = 1e3 * chain.deviation(q[here], (hot + cold).evaluate(q[here])).position_mm
    return machine, tip, q, measured, expected


def test_touches_are_what_the_exact_chain_makes_of_hot_and_cold_errors_together(made):
    _, _, _, measured, expected = made
    off = measured - expected
    assert np.abs(expected).max() > 20.0 * NOISE_UM
    assert np.abs(off).max() < 6.0 * NOISE_UM
    assert abs(off.mean()) < 4.0 * NOISE_UM / np.sqrt(off.size)


def test_their_noise_is_as_stated_and_nothing_else(made):
    _, _, _, measured, expected = made
    off = measured - expected
    assert off.std() == pytest.approx(NOISE_UM, rel=4.0 / np.sqrt(2.0 * off.size))


def test_they_lie_in_the_working_volume_and_fill_it(made):
    machine, _, q, _, _ = made
    for k, name in enumerate(machine.axis_names):
        axis = machine.axes[name]
        assert (q[:, k] >= axis.low).all()
        assert (q[:, k] <= axis.high).all()
        assert np.ptp(q[:, k]) > 0.9 * (axis.high - axis.low)


def test_there_are_some_at_each_time_of_the_error_terms(made):
    _, tip, _, _, _ = made
    assert set(tip.numbers) == {"time_s", *made[0].axis_names, "dx_um", "dy_um", "dz_um"}
    times, counts = np.unique(tip.numbers["time_s"], return_counts=True)
    np.testing.assert_array_equal(times, np.arange(37) * 300.0)
    np.testing.assert_array_equal(counts, 2 * TOUCHES)


def test_a_probe_disturbs_nothing(tmp_path):
    shop = open_shop("vmc3")
    make_dataset(shop, 1, 1.0, 0, tmp_path / "without", pictures=False)
    make_dataset(shop, 1, 1.0, 0, tmp_path / "with", tool_tip=True, pictures=False)
    for name in ("telemetry.parquet", "error_terms.parquet", "geometry.csv"):
        assert (tmp_path / "with" / name).read_bytes() == (tmp_path / "without" / name).read_bytes()
    assert "tool_tip" not in {path.stem for path in (tmp_path / "without").iterdir()}
