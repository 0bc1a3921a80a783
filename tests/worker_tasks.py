"""Work for other processes, which find it by name; this file imports little, so that they start quickly."""

import os
import signal
import time

from data_synth.workers import THREADS
from model.exceptions import InputError


def double(i):
    return 2 * i


def uneven(i):
    time.sleep(0.1 if i % 2 == 0 else 0.0)
    return i, os.getpid()


def settings(i):
    return {name: os.environ.get(name) for name in THREADS}, signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def dies(i):
    if i == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return i


def refuses(i):
    if i == 1:
        raise InputError("runs must be even, got 1")
    return i


def breaks(i):
    return 1 / (i - 1)


class Leaves:
    """Leaves a file for each piece of work begun."""

    def __init__(self, folder):
        self.folder = folder

    def __call__(self, i):
        (self.folder / str(i)).touch()
        return i
