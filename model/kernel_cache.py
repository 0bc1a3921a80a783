"""Compilation of the per-position path, and where the result is kept between starts.

Numba keeps it beside the source, or in the user's cache folder, or in `NUMBA_CACHE_DIR`. Importing `model.kernel`
loads it or, once for a version and a processor, compiles it: at installation or when a program starts, never when a
position is asked for.
"""

from __future__ import annotations

import atexit
import logging
import os
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numba
from numba.core import config as numba_config

log = logging.getLogger(__name__)
config: Any = numba_config

# Contracting a multiplication and an addition keeps numbers that are not numbers as they are; other liberties do not.
OPTIONS: dict[str, Any] = {"nogil": True, "fastmath": {"contract"}, "error_model": "numpy"}
PATIENCE_S = 1.5
"""Loading takes some tenths of a second; who waits longer is told why."""


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a part of the path with whatever calls it."""
    return numba.njit(**OPTIONS)(function)


def kept(signature: str) -> Callable[[Callable[..., Any]], Any]:
    """Compile the path for that signature at once, or load what was kept of it."""

    def compile_or_load(function: Callable[..., Any]) -> Any:
        _use_a_writable_copy()
        with _telling():
            try:
                return numba.njit(signature, cache=True, **OPTIONS)(function)
            except RuntimeError as problem:
                if "cannot cache" not in str(problem):
                    raise
            log.warning("the compiled path cannot be kept for the next start; set NUMBA_CACHE_DIR to a writable folder")
            return numba.njit(signature, **OPTIONS)(function)

    return compile_or_load


def _use_a_writable_copy() -> None:
    """Copy what was kept to a folder of this process where its own is read-only, as in a container: Numba asks for one.

    Where there is no such folder either, the path is compiled and not kept.
    """
    shipped = config.CACHE_DIR
    if not shipped or not os.path.isdir(shipped) or os.access(shipped, os.W_OK):
        return
    try:
        copy = tempfile.mkdtemp(prefix="thermotrue-")
        atexit.register(shutil.rmtree, copy, ignore_errors=True)
        shutil.copytree(shipped, copy, dirs_exist_ok=True)
        os.chmod(copy, 0o700)  # copytree gives it the mode of the original
    except OSError as problem:
        log.warning("no writable folder for the compiled path (%s)", problem.strerror)
        return
    config.CACHE_DIR = copy


@contextmanager
def _telling() -> Iterator[None]:
    """Say that the path is being compiled, if that takes long."""

    def tell() -> None:
        log.info("compiling the per-position path, once for this version and processor")
        if sys.stderr.isatty():
            print("compiling, once for this version and processor (some ten seconds)", file=sys.stderr)

    timer = threading.Timer(PATIENCE_S, tell)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
