"""A lock that one process has and that ends with it, however it ends."""

from __future__ import annotations

import os
import sys
from pathlib import Path


class FileLock:
    """A lock on a file beside what it guards; `taken` says whether this process has it.

    Raises
    ------
    OSError
        where the file cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o600)
        self.taken = _take(self._descriptor)
        if not self.taken:
            os.close(self._descriptor)

    def release(self) -> None:
        """Give it back."""
        if self.taken:
            os.close(self._descriptor)
            self.taken = False


if sys.platform == "win32":

    def _take(descriptor: int) -> bool:
        import msvcrt  # noqa: PLC0415 (exists on this system alone)

        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
else:

    def _take(descriptor: int) -> bool:
        import fcntl  # noqa: PLC0415 (exists on this system alone)

        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
