from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pyarrow import parquet

from data_synth.faults import KINDS, MOST_PER_100H, Request, apply, parse, plan
from data_synth.geometric import geometry
from data_synth.machines import open_shop
from data_synth.run import simulate
from data_synth.writer import DataSetWriter
from model.exceptions import InputError
from model.tables import find_table, read_table
from training.dataset import load_dataset

SENSORS = tuple("abcdef")
SHOP = open_shop("vmc3")
OFTEN = Request(dict.fromkeys(KINDS, 6.0) | {"swapped": 1.0})


def clock(hours, period_s=60.0):
    return np.arange(round(hours * 3600.0 / period_s) + 1) * period_s


def readings_of(sensors, time_s):
    """Return readings of which no two are alike, so that a changed cell shows."""
    rng = np.random.default_rng(17)
    order = rng.permutation(len(sensors) * len(time_s)).reshape(len(sensors), len(time_s))
    return {sensor: 20.0 + row / 1e3 for sensor, row in zip(sensors, order, strict=True)}


def planned(request, time_s, seed=0, sensors=SENSORS):
    return plan("r00", sensors, time_s, request, np.random.default_rng(seed))


@st.composite
def faulty_runs(draw):
    """Draw a log and its faults, from none to far too many."""
    sensors = tuple("abcdefgh"[: draw(st.integers(1, 8))])
    time_s = clock(draw(st.floats(0.1, 40.0)), draw(st.sampled_from([1.0, 20.0, 60.0, 300.0])))
    assume(2 <= len(time_s) <= 5000)
    rates = draw(st.dictionaries(st.sampled_from([*KINDS]), st.floats(0.1, MOST_PER_100H), min_size=1))
    faults = planned(Request(rates), time_s, draw(st.integers(0, 2**32)), sensors)
    return time_s, readings_of(sensors, time_s), rates, faults


@settings(deadline=None, max_examples=150)
@given(faulty_runs())
def test_each_labelled_reading_shows_its_fault_and_no_other_is_touched(case):
    time_s, healthy, rates, faults = case
    shown = apply(healthy, time_s, faults)
    untouched = {sensor: np.ones(len(time_s), dtype=bool) for sensor in healthy}
    for fault in faults:
        assert fault.kind in rates
        cells = fault.cells(time_s)
        untouched[fault.sensor] &= ~cells
        assert time_s[cells][0] == fault.start_s
        assert time_s[cells][-1] == fault.end_s
        got, was = shown[fault.sensor][cells], healthy[fault.sensor][cells]
        match fault.kind:
            case "dropout":
                assert np.isnan(got).all()
            case "stuck":
                before = np.flatnonzero(cells)[0] - 1
                np.testing.assert_array_equal(got, healthy[fault.sensor][before])
            case "spike":
                assert len(got) == 1
                np.testing.assert_allclose(got - was, fault.magnitude_K)
            case "offset":
                np.testing.assert_allclose(got - was, fault.magnitude_K)
            case "swapped":
                np.testing.assert_array_equal(got, healthy[fault.other][cells])
        assert (fault.magnitude_K is not None) == (fault.kind in ("spike", "offset"))
        assert (fault.other is not None) == (fault.kind == "swapped")
    for sensor, cells in untouched.items():
        np.testing.assert_array_equal(shown[sensor][cells], healthy[sensor][cells])


@settings(deadline=None, max_examples=100)
@given(faulty_runs())
def test_a_sensor_has_one_fault_at_a_time_and_always_some_reading(case):
    time_s, healthy, _, faults = case
    assert [f.start_s for f in faults] == sorted(f.start_s for f in faults)
    for sensor in healthy:
        mine = [fault for fault in faults if fault.sensor == sensor]
        for one, following in pairwise(mine):
            assert ((one.end_s < time_s) & (time_s < following.start_s)).any()
        assert np.isfinite(apply(healthy, time_s, faults)[sensor]).any()
        assert not any(f.start_s == time_s[0] and f.kind != "swapped" for f in mine)


@settings(deadline=None, max_examples=50)
@given(faulty_runs())
def test_exchanged_cables_exchange_two_columns_and_no_more(case):
    time_s, healthy, _, faults = case
    swaps = {fault.sensor: fault for fault in faults if fault.kind == "swapped"}
    shown = apply(healthy, time_s, tuple(swaps.values()))
    for sensor, fault in swaps.items():
        other = swaps[fault.other]
        assert (other.other, other.start_s, other.end_s) == (sensor, fault.start_s, time_s[-1])
    # Exchanging the same cables again puts all right.
    again = apply(shown, time_s, tuple(swaps.values()))
    for sensor, values in healthy.items():
        np.testing.assert_array_equal(again[sensor], values)


def test_applying_faults_leaves_the_true_readings_as_they_are():
    time_s = clock(10.0)
    healthy = readings_of(SENSORS, time_s)
    before = {sensor: values.copy() for sensor, values in healthy.items()}
    faults = planned(parse("all"), time_s)
    assert faults
    apply(healthy, time_s, faults)
    for sensor, values in before.items():
        np.testing.assert_array_equal(healthy[sensor], values)


def test_the_same_seed_gives_the_same_faults_and_another_others():
    time_s = clock(40.0)
    request = parse("all")
    assert planned(request, time_s, 1) == planned(request, time_s, 1)
    assert planned(request, time_s, 1) != planned(request, time_s, 2)


def test_asking_for_one_more_kind_moves_no_other():
    """But for those that would befall a sensor that is faulty already."""
    time_s = clock(400.0)
    alone = planned(parse("spike"), time_s)
    among = [f for f in planned(parse("spike,dropout=0.5"), time_s) if f.kind == "spike"]
    assert set(among) <= set(alone)
    assert len(among) > 0.9 * len(alone)


@pytest.mark.parametrize("period_s", [20.0, 300.0])
@pytest.mark.parametrize("kind", [*KINDS])
def test_faults_come_as_often_as_asked_whatever_the_period(kind, period_s):
    """Counted in hours of healthy sensors; the bounds are four standard deviations of a Poisson count."""
    time_s = clock(50.0, period_s)
    rate = 2.0 if kind != "swapped" else 0.2
    count, healthy_h = 0, 0.0
    for seed in range(120):
        faults = planned(Request({kind: rate}), time_s, seed)
        count += len(faults)
        faulty = sum(f.cells(time_s).sum() for f in faults if f.start_s > 0.0)
        healthy_h += (len(SENSORS) * len(time_s) - faulty) * period_s / 3600.0
    expected = rate * healthy_h / 100.0
    assert abs(count - expected) < 4.0 * np.sqrt(expected * (2.0 if kind == "swapped" else 1.0))


def test_all_sensors_are_hit_alike_and_at_all_times():
    time_s = clock(20.0)
    faults = [f for seed in range(60) for f in planned(parse("spike=20"), time_s, seed)]
    hits = np.array([sum(f.sensor == sensor for f in faults) for sensor in SENSORS])
    assert np.abs(hits - hits.mean()).max() < 4.0 * np.sqrt(hits.mean())
    early = sum(f.start_s < 10 * 3600.0 for f in faults)
    assert abs(early - len(faults) / 2) < 4.0 * np.sqrt(len(faults) / 4)


def test_faults_are_as_long_and_as_large_as_their_kind_says():
    time_s = clock(200.0)
    faults = [f for seed in range(30) for f in planned(parse("all"), time_s, seed)]
    assert {f.kind for f in faults} == set(KINDS)
    for fault in faults:
        habit = KINDS[fault.kind]
        lasted = fault.end_s - fault.start_s
        assert lasted <= habit.lasts_s[1]
        if fault.end_s < time_s[-1]:
            assert lasted >= habit.lasts_s[0] - 2 * 60.0
        if habit.size_K is not None:
            assert habit.size_K[0] <= abs(fault.magnitude_K) <= habit.size_K[1]
    down = np.mean([f.magnitude_K < 0 for f in faults if f.kind == "offset"])
    assert down == pytest.approx(0.75, abs=0.15)


def test_a_lone_sensor_has_no_cable_to_be_exchanged_with():
    assert planned(parse("swapped=1000"), clock(100.0), sensors=("a",)) == ()


def test_a_request_is_read_as_it_is_written():
    assert parse("dropout, stuck=2 ,spike").per_100h == {"dropout": 1.0, "stuck": 2.0, "spike": 2.0}
    assert parse("all").per_100h == {kind: habit.per_100h for kind, habit in KINDS.items()}
    assert parse("spike,dropout") == parse("dropout,spike")


@given(st.dictionaries(st.sampled_from([*KINDS]), st.floats(1e-6, MOST_PER_100H), min_size=1))
def test_a_requests_text_gives_it_back(rates):
    assert parse(Request(rates).text) == Request(rates)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("dropuot", "faults must be kinds such as 'dropout,stuck=2', or 'all', got 'dropuot'; did you mean 'dropout'"),
        ("spike,", "faults must be kinds such as .*, got ''; known are dropout, offset, spike, stuck, swapped$"),
        ("", "faults must be kinds such as"),
        ("all,spike", "faults must be kinds such as .*, got 'all'"),
        ("spike,spike=2", "fault 'spike' must be named once, got it twice in 'spike,spike=2'$"),
        ("spike=0", "fault 'spike' must come more than 0 and at most 1000 times in 100 hours of a sensor, got '0'$"),
        ("spike=", "fault 'spike' must come more than 0 .* got ''$"),
        ("spike=often", "fault 'spike' must come more than 0 .* got 'often'$"),
        ("stuck=nan", "fault 'stuck' must come more than 0"),
        ("stuck=1001", "fault 'stuck' must come more than 0"),
        ("stuck=-1", "fault 'stuck' must come more than 0"),
    ],
)
def test_a_request_that_makes_no_sense_is_refused(text, message):
    with pytest.raises(InputError, match=f"^{message}"):
        parse(text)


def ran(faults=None, period_s=60.0, name="r00_shop", seed=(3, 0)):
    return simulate(SHOP, name, "shop", seed, 12.0, period_s=period_s, faults=faults)


@pytest.fixture(scope="module")
def healthy():
    return ran()


@pytest.fixture(scope="module")
def faulty():
    return ran(OFTEN)


def test_a_run_with_faults_is_the_run_without_but_for_the_faulty_readings(healthy, faulty):
    assert healthy.faults is None
    assert {fault.kind for fault in faulty.faults} == set(KINDS)
    assert {fault.run for fault in faulty.faults} == {"r00_shop"}
    for sensor, values in healthy.sensors.items():
        labelled = np.any([f.cells(faulty.time_s) for f in faulty.faults if f.sensor == sensor], axis=0)
        np.testing.assert_array_equal(faulty.sensors[sensor][~labelled], values[~labelled])
    for one, other in ((healthy.channels, faulty.channels), (healthy.terms.motion, faulty.terms.motion)):
        for name, values in one.items():
            np.testing.assert_array_equal(other[name], values)
    np.testing.assert_array_equal(healthy.nodes_degC, faulty.nodes_degC)


def test_the_same_faults_come_at_another_period(faulty):
    """They are seen from the first reading after they began to the last before they end."""
    coarse = ran(OFTEN, period_s=300.0)
    fine = {(f.sensor, f.kind, f.magnitude_K): f for f in faulty.faults if f.end_s - f.start_s > 900.0}
    found = {(f.sensor, f.kind, f.magnitude_K): f for f in coarse.faults}
    assert len(fine) > 5
    for which, fault in fine.items():
        assert 0.0 <= found[which].start_s - fault.start_s < 300.0
        assert 0.0 <= fault.end_s - found[which].end_s < 300.0


def test_readings_with_faults_are_still_of_this_world(faulty):
    shown = np.array([*faulty.sensors.values()])
    assert np.nanmax(np.abs(shown)) < 300.0
    steps = shown[np.isfinite(shown)] / 0.1
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_training_reads_a_data_set_with_faults_and_sees_the_missing_readings(form, tmp_path, healthy, faulty):
    runs = (faulty, ran(Request({"spike": 1e-6}), name="r01_shop", seed=(3, 1)))
    assert runs[1].faults == ()
    cold = geometry(SHOP.machine, np.random.default_rng(0), SHOP.design.workmanship)
    with DataSetWriter(tmp_path, SHOP.machine, cold, form) as writer:
        for run in runs:
            writer.write(run)
    data = load_dataset(tmp_path)
    assert data.sensors == tuple(SHOP.machine.sensors)
    assert not {"magnitude_K", "other"} & set(data.channels)
    for run in runs:
        seen = data.runs[run.name].telemetry.temperatures
        np.testing.assert_array_equal(seen, np.column_stack([run.sensors[s] for s in data.sensors]))
    missing = np.isnan(data.runs["r00_shop"].telemetry.temperatures)
    assert missing.sum() == sum(f.cells(faulty.time_s).sum() for f in faulty.faults if f.kind == "dropout")
    if form == "csv":  # not a number that is not one
        assert "nan" not in (tmp_path / "telemetry.csv").read_text().lower()
    else:
        written = parquet.read_table(tmp_path / "telemetry.parquet")
        assert sum(written[sensor].null_count for sensor in data.sensors) == missing.sum() > 0
    table = read_table(find_table(tmp_path, "faults"), text=("run", "sensor", "kind", "other"))
    rows = zip(*table.text.values(), *(table.numbers[c] for c in ("start_s", "end_s", "magnitude_K")), strict=True)
    assert list(table.text) == ["run", "sensor", "kind", "other"]
    for (run, sensor, kind, other, start_s, end_s, magnitude_K), fault in zip(rows, faulty.faults, strict=True):
        assert (run, sensor, kind, other or None) == (fault.run, fault.sensor, fault.kind, fault.other)
        assert (start_s, end_s) == (fault.start_s, fault.end_s)
        np.testing.assert_equal(magnitude_K, np.nan if fault.magnitude_K is None else fault.magnitude_K)


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_the_table_of_faults_is_there_where_they_were_asked_for(form, tmp_path, healthy):
    cold = geometry(SHOP.machine, np.random.default_rng(0), SHOP.design.workmanship)
    without, none_came = ran(), ran(Request({"spike": 1e-6}))
    for folder, run, there in (("a", without, False), ("b", none_came, True)):
        (tmp_path / folder).mkdir()
        with DataSetWriter(tmp_path / folder, SHOP.machine, cold, form) as writer:
            writer.write(run)
        assert (tmp_path / folder / f"faults.{form}").is_file() == there
    telemetry = [(tmp_path / folder / f"telemetry.{form}").read_bytes() for folder in "ab"]
    assert telemetry[0] == telemetry[1]
    assert len(read_table(tmp_path / "b" / f"faults.{form}", text=("run", "sensor", "kind", "other"))) == 0
