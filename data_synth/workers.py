"""Work on several processes, its results in order, and no more of them in memory than there are processes."""

from __future__ import annotations

import os
import signal
import threading
import traceback
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from model.exceptions import ComputeError, ThermotrueError

Result = TypeVar("Result")

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""What the linear algebra libraries read when they are loaded."""
PATIENCE_S = 5.0  # for a process to end when it has been told to


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_order(work: Callable[[int], Result], n: int, workers: int) -> Generator[Result]:
    """Yield work(0) ... work(n - 1), made by that many processes, or by this one where it is 1.

    Process k makes every `workers`-th result from the k-th on, and begins one when its last has been fetched: with a
    slow consumer each waits with one result. Close the iterator to stop early; its processes end with it.

    Parameters
    ----------
    work : must be picklable and reach each new process once; where a program without a console script makes
        processes, its work stands under `if __name__ == "__main__":`

    Raises
    ------
    ThermotrueError
        what `work` raised, or ComputeError for another exception of it or for a process that ended.
    """
    if min(workers, n) <= 1:
        yield from map(work, range(n))
        return
    with ExitStack() as open_:
        with _starting():
            mine = [open_.enter_context(_Worker()) for _ in range(min(workers, n))]
        for i, worker in enumerate(mine):  # after all have started, since this waits for each to be there
            worker.employ(work, i)
        workers = len(mine)
        for i in range(n):
            worker = mine[i % workers]
            result = worker.fetch()
            if i + workers < n:
                worker.begin(i + workers)
            yield result


class _Worker:
    """A process that makes one result at a time."""

    def __init__(self) -> None:
        # A fresh interpreter: a fork of a process with threads (pyarrow's) may hang.
        context = get_context("spawn")
        self._here, there = context.Pipe()
        self._process = context.Process(target=_serve, args=(there,), daemon=True)
        self._process.start()
        there.close()  # so that the end of the process is the end of the pipe
        self._at = 0

    def __enter__(self) -> _Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._here.close()
        self._process.terminate()
        self._process.join(PATIENCE_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def employ(self, work: Callable[[int], Any], first: int) -> None:
        """Say what is to be done, and ask for the first result."""
        self._at = first
        self._send(work)
        self.begin(first)

    def begin(self, i: int) -> None:
        """Ask for result `i`."""
        self._at = i
        self._send(i)

    def fetch(self) -> Any:
        """Wait for the result asked for."""
        try:
            result, problem = self._here.recv()
        except (EOFError, OSError):
            raise self._ended() from None
        if problem is not None:
            raise problem
        return result

    def _send(self, what: object) -> None:
        try:
            self._here.send(what)
        except OSError:
            raise self._ended() from None

    def _ended(self) -> ComputeError:
        self._process.join(PATIENCE_S)
        return ComputeError(
            f"the process of run {self._at} ended with code {self._process.exitcode} before the run was there; "
            "where memory is short, give fewer workers"
        )


def _serve(there: Connection) -> None:
    """Make the results asked for until nobody asks."""
    try:
        work = there.recv()
        while True:
            there.send(_attempt(work, there.recv()))
    except (EOFError, OSError):
        pass


def _attempt(work: Callable[[int], Any], i: int) -> tuple[Any, ThermotrueError | None]:
    try:
        return work(i), None
    except ThermotrueError as problem:
        return None, problem
    except Exception as problem:  # anything else may not survive the way between processes
        told = ComputeError(f"run {i} failed with {type(problem).__name__}: {problem}")
        told.add_note(traceback.format_exc())
        return None, told


@contextmanager
def _starting() -> Iterator[None]:
    """Let new processes have one thread each, and leave Ctrl-C to this one, which ends them."""
    before = {name: os.environ.get(name) for name in THREADS}
    here = threading.current_thread() is threading.main_thread()
    handler = signal.getsignal(signal.SIGINT)
    os.environ.update(dict.fromkeys(THREADS, "1"))
    if here:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # inherited by what starts now
    try:
        yield
    finally:
        if here:
            signal.signal(signal.SIGINT, handler)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
