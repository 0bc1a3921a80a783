"""Where the compiled per-position path is kept, and how it is loaded: without the compiler, which takes much memory.

It is compiled once for a version and a processor, in a process of its own, and kept in `NUMBA_CACHE_DIR`, or beside the
source, or in the user's cache folder. A folder that can only be read will do. Where there is none, it is compiled at
each start; and where its object code cannot be loaded, as on other processors than x86-64, the compiler does it here.
"""

from __future__ import annotations

import ctypes
import hashlib
import logging
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from model.kernel_object import SUPPORTED, ObjectError, load

log = logging.getLogger(__name__)

HERE = Path(__file__).parent
SOURCES = ("kernel_source.py", "kernel_constants.py", "kernel_build.py")
TELLING = "compiling the per-position path, once for this version and processor"
ARGUMENTS = "pqqqppqppqpqpqppppqpqqpppppppp"
"""Of `kernel_source.entry`: addresses and whole numbers."""
_TYPES = {"p": ctypes.c_void_p, "q": ctypes.c_int64}

Entry = Callable[..., None]


def entry() -> tuple[Entry, Any]:
    """Return the compiled path, and what it stays in memory by."""
    if SUPPORTED and platform.machine() == "x86_64":
        try:
            return _direct(_kept() or _keep(_compile()))
        except ObjectError as problem:
            log.warning("the compiler is loaded along with the compiled path", extra={"reason": str(problem)})
    return _through_the_compiler()


def _direct(content: bytes) -> tuple[Entry, Any]:
    """Return the path loaded from its object code."""
    name, _, code = content.partition(b"\n")
    loaded = load(code, name.decode())
    # As Numba calls its functions: where to put the result and the exception, of which there are none, comes first.
    types = [_TYPES[kind] for kind in ARGUMENTS]
    call = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p, *types)(loaded.address)
    nowhere = (ctypes.c_int64 * 2)()
    result, exception = ctypes.addressof(nowhere), ctypes.addressof(nowhere) + 8

    def run(*arguments: int) -> None:
        status = call(result, exception, *arguments)
        if status != 0:
            raise RuntimeError(f"the compiled path must return 0, got {status}")

    return run, (loaded, nowhere)


def _through_the_compiler() -> tuple[Entry, Any]:
    from model.kernel_build import compiled  # noqa: PLC0415 (the compiler is large)

    print(TELLING, file=sys.stderr)
    try:
        path = compiled(keep_object=True)
    except RuntimeError as problem:
        if "cannot cache" not in str(problem):
            raise
        path = compiled(keep_object=False)
    types = [_TYPES[kind] for kind in ARGUMENTS]
    return ctypes.CFUNCTYPE(None, *types)(path.address), path


def _compile() -> bytes:
    """Return the path's name and object code, from a process that ends with its compiler."""
    print(TELLING, file=sys.stderr)
    with tempfile.TemporaryDirectory(prefix="thermotrue-") as folder:
        environment = os.environ | {"NUMBA_CACHE_DIR": folder, "PYTHONPATH": str(HERE.parent)}
        done = subprocess.run(
            [sys.executable, "-m", "model.kernel_build"], env=environment, capture_output=True, check=False
        )
    if done.returncode != 0:
        last = (done.stderr.decode(errors="replace").strip().splitlines() or ["no reason"])[-1]
        raise ObjectError(f"the compiler failed: {last}")
    return done.stdout


def _kept() -> bytes | None:
    """Return what was kept, where it is whole."""
    for folder in _folders():
        with suppress(OSError):
            content = (folder / _name()).read_bytes()
            digest, _, rest = content.partition(b"\n")
            if digest == hashlib.sha256(rest).hexdigest().encode():
                return rest
    return None


def _keep(content: bytes) -> bytes:
    """Keep it in the first folder that can be written to, whole or not at all; return it."""
    for folder in _folders():
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=folder, prefix="kernel-", delete=False) as file:
                file.write(hashlib.sha256(content).hexdigest().encode() + b"\n" + content)
            os.chmod(file.name, 0o644)
            os.replace(file.name, folder / _name())
            return content
    log.warning("the compiled path cannot be kept; set NUMBA_CACHE_DIR to a folder that can be written to")
    return content


def _folders() -> Iterator[Path]:
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        yield Path(given)
        return
    yield HERE / "__pycache__"
    with suppress(RuntimeError):  # no home
        yield Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "thermotrue"


def _name() -> str:
    """Return the file's name: another one for other sources, another compiler, another processor."""
    known = hashlib.sha256()
    for source in SOURCES:
        known.update((HERE / source).read_bytes())
    for package in ("numba", "llvmlite"):
        with suppress(PackageNotFoundError):
            known.update(version(package).encode())
    known.update(_processor().encode())
    return f"kernel-{known.hexdigest()[:32]}.bin"


def _processor() -> str:
    """Return what decides which instructions there are."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    first = {line.partition(":")[0].strip(): line for line in reversed(lines)}
    return "\n".join([platform.machine(), first.get("model name", ""), first.get("flags", "")])
