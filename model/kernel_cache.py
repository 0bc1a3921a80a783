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
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numba
from numba.core import config as numba_config
from numba.core import event

log = logging.getLogger(__name__)
config: Any = numba_config


Decorator = Callable[[Callable[..., Any]], Any]


def compiler(options: Mapping[str, Any]) -> Decorator:
    """Return what compiles a part of the path with whatever calls it.

    The options come from the file that is compiled, since it alone tells Numba whether what it kept is still good.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        return numba.njit(**options)(function)

    return compiled


def keeper(options: Mapping[str, Any]) -> Callable[[str], Decorator]:
    """Return what compiles the path for a signature at once, or loads what was kept of it."""

    def kept(signature: str) -> Decorator:
        def compile_or_load(function: Callable[..., Any]) -> Any:
            _use_a_writable_copy()
            with _telling():
                try:
                    return numba.njit(signature, cache=True, **options)(function)
                except RuntimeError as problem:
                    if "cannot cache" not in str(problem):
                        raise
                log.warning("the compiled path cannot be kept; set NUMBA_CACHE_DIR to a folder that can be written to")
                return numba.njit(signature, **options)(function)

        return compile_or_load

    return kept


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
    """Say that the path is being compiled, and not loaded: to whoever starts a command or reads a journal."""
    with event.install_listener("numba:compile", _Teller()):
        yield


class _Teller(event.Listener):
    told = False

    def on_start(self, event: object) -> None:
        if not self.told:
            print("compiling the per-position path, once for this version and processor", file=sys.stderr)
        self.told = True

    def on_end(self, event: object) -> None:
        pass
