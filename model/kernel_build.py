"""Compile the per-position path: `python -m model.kernel_build` writes its machine code to standard output.

It runs in a process of its own: the compiler takes memory that a service would keep for good, for nothing.
"""

from __future__ import annotations

import sys
from typing import Any

import numba

from model.kernel_source import OPTIONS, SIGNATURE, entry


def compiled(*, keep_object: bool) -> Any:
    """Return the compiled entry; with its object code, where that is wanted."""
    options = {name: OPTIONS[name] for name in ("fastmath", "error_model")}
    cfunc: Any = numba.cfunc  # its stub does not know its options
    return cfunc(SIGNATURE, nopython=True, cache=keep_object, **options)(entry)


def object_code() -> tuple[bytes, str]:
    """Return the entry's object code, as the linker would get it, and the name that it has there."""
    path = compiled(keep_object=True)
    library = path._library
    return bytes(library._compiled_object), str(path.native_name).removeprefix("cfunc.")


if __name__ == "__main__":
    code, name = object_code()
    sys.stdout.buffer.write(name.encode() + b"\n" + code)
