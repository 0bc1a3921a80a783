import os
import signal
import time

import pytest
from worker_tasks import Leaves, breaks, dies, double, refuses, settings, uneven

from data_synth.dataset import make_dataset
from data_synth.machines import DESIGNS, open_shop
from data_synth.workers import THREADS, in_order
from model.exceptions import ComputeError, InputError


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_results_come_in_order_from_as_many_processes_as_asked_for():
    found = list(in_order(uneven, 6, 2))
    assert [i for i, _ in found] == list(range(6))
    assert len({pid for _, pid in found} - {os.getpid()}) == 2


def test_there_are_no_more_processes_than_results():
    assert {pid for _, pid in in_order(uneven, 2, 1)} == {os.getpid()}
    assert {pid for _, pid in in_order(uneven, 1, 8)} == {os.getpid()}
    assert list(in_order(double, 0, 4)) == []


def test_a_process_has_one_thread_and_leaves_the_interrupt_to_its_parent():
    before = {name: os.environ.get(name) for name in THREADS}, signal.getsignal(signal.SIGINT)
    for environment, ignores in in_order(settings, 2, 2):
        assert environment == dict.fromkeys(THREADS, "1")
        assert ignores
    assert ({name: os.environ.get(name) for name in THREADS}, signal.getsignal(signal.SIGINT)) == before


def test_no_more_is_begun_than_the_consumer_lets(tmp_path):
    """What waits does not grow with what there is to do: at most two results ahead of two taken by two workers."""
    made = in_order(Leaves(tmp_path), 50, 2)
    assert [next(made), next(made)] == [0, 1]
    time.sleep(0.5)
    assert len(list(tmp_path.iterdir())) <= 4
    made.close()
    time.sleep(0.2)
    assert len(list(tmp_path.iterdir())) <= 4


def test_processes_end_with_their_iterator():
    made = in_order(uneven, 50, 2)
    pids = {next(made)[1], next(made)[1]}
    assert all(map(alive, pids))
    made.close()
    assert not any(map(alive, pids))


@pytest.mark.parametrize("workers", [1, 2])
def test_a_mistake_of_the_user_comes_through_as_it_is(workers):
    with pytest.raises(InputError, match="^runs must be even, got 1$"):
        list(in_order(refuses, 4, workers))


def test_another_exception_is_one_sentence_and_keeps_its_traceback():
    with pytest.raises(ComputeError, match=r"^run 1 failed with ZeroDivisionError: division by zero") as problem:
        list(in_order(breaks, 4, 2))
    assert "in breaks" in "".join(problem.value.__notes__)


def test_a_process_that_dies_is_named():
    with pytest.raises(ComputeError, match=r"^the process of run 1 ended with code -9 before"):
        list(in_order(dies, 4, 2))


def test_the_bytes_do_not_depend_on_the_workers(tmp_path):
    shop = open_shop("vmc3")
    for workers in (1, 2):
        make_dataset(shop, 5, 1.0, 11, tmp_path / str(workers), tool_tip=True, workers=workers)
    names = {path.name for path in (tmp_path / "1").iterdir()}
    assert {"tool_tip.parquet", "volume.png", "README.md"} < names
    assert names == {path.name for path in (tmp_path / "2").iterdir()}
    for name in names:
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes(), name


@pytest.mark.parametrize("workers", [1, 2])
def test_a_run_that_fails_leaves_no_folder(workers, tmp_path, monkeypatch):
    shop = open_shop("vmc3")
    broken = type(shop)(shop.machine, shop.design, None)  # no fields: the first run fails
    with pytest.raises((ComputeError, AttributeError)):
        make_dataset(broken, 3, 1.0, 0, tmp_path / "data", workers=workers)
    assert not list(tmp_path.iterdir())


def test_an_interrupt_leaves_no_folder_and_no_process(tmp_path):
    def stops(items):
        yield items[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_dataset(open_shop("vmc3"), 20, 1.0, 0, tmp_path / "data", track=stops, workers=2)
    assert not list(tmp_path.iterdir())


def test_no_workers_are_none():
    with pytest.raises(InputError, match="^workers must be at least 1, got 0"):
        make_dataset(open_shop("vmc3"), 2, 1.0, 0, None, workers=0)


@pytest.mark.parametrize("name", [*DESIGNS, "vmc3~1"])
def test_a_machine_reaches_a_process_in_one_small_piece(name):
    import pickle

    shop = open_shop(name)
    sent = pickle.dumps(shop)
    assert len(sent) < 1e7  # with what its network has computed already
    again = pickle.loads(sent)  # noqa: S301 (our own)
    assert again.machine == shop.machine
    assert again.design == shop.design
