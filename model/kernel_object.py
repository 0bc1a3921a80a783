"""Load object code of the compiled path: what a linker does, for the one file that the compiler writes.

The compiler itself would do it, too, and takes as much memory along as the rest of the service; llvmlite, its
foundation, half of that. The code is mapped, its addresses are put in, and then it can be executed and no longer be
written. Anything that is not as expected is refused, and the compiler does the work; whether the path computes what the
chain says is checked before it is used (`service/self_test.py`).
"""

from __future__ import annotations

import ctypes
import mmap
import struct
import sys
from dataclasses import dataclass

SUPPORTED = sys.platform == "linux" and sys.byteorder == "little"
X86_64 = 62
ABSOLUTE, RELATIVE_32, CALL_32, RELATIVE_64 = 1, 2, 4, 24
"""Relocations of the System V ABI for x86-64: 64 bits of an address, 32 of a distance, twice, 64 of a distance."""
PROGBITS, SYMTAB, RELA, NOBITS, ALLOCATED = 1, 2, 4, 8, 2
MATHS = frozenset({"atan2", "sincos", "sin", "cos", "sqrt", "floor"})
MEMORY = frozenset({"memset", "memcpy", "memmove"})
NEVER = ("Py", "numba_", "NRT_")
"""How the names begin of what raises exceptions and counts references. The path does neither; `abort` stands there."""


class ObjectError(Exception):
    """Object code is not as this loader knows it."""


@dataclass(frozen=True)
class _Section:
    kind: int
    flags: int
    offset: int
    size: int
    link: int
    info: int
    align: int


@dataclass(frozen=True)
class Loaded:
    """Executable code; it is there as long as `memory` is."""

    address: int
    memory: mmap.mmap


def load(code: bytes, name: str) -> Loaded:
    """Return the function of that name.

    Raises
    ------
    ObjectError
        where the code is not for this processor, or needs what is not known here.
    """
    if not SUPPORTED:
        raise ObjectError("object code is loaded on Linux alone")
    try:
        return _Linker(code).link(name)
    except (struct.error, IndexError, ValueError, OSError) as problem:
        raise ObjectError(f"object code cannot be loaded: {problem}") from None


class _Linker:
    def __init__(self, code: bytes) -> None:
        if code[:6] != b"\x7fELF\x02\x01" or struct.unpack_from("<H", code, 18)[0] != X86_64:
            raise ObjectError("object code must be ELF for x86-64")
        self._code = code
        (start,) = struct.unpack_from("<Q", code, 0x28)
        size, count = struct.unpack_from("<HH", code, 0x3A)
        self._sections = [self._section(start + i * size) for i in range(count)]
        self._places: dict[int, int] = {}
        room = 0
        for index, section in enumerate(self._sections):
            if section.flags & ALLOCATED and section.kind in {PROGBITS, NOBITS}:
                room = -(-room // max(section.align, 1)) * max(section.align, 1)
                self._places[index] = room
                room += section.size
        self._memory = mmap.mmap(-1, max(room, 1), prot=mmap.PROT_READ | mmap.PROT_WRITE)
        self._base = ctypes.addressof(ctypes.c_char.from_buffer(self._memory))

    def link(self, name: str) -> Loaded:
        """Return the function, its addresses put in, executable and no longer writable."""
        for index, place in self._places.items():
            section = self._sections[index]
            if section.kind == PROGBITS:
                self._memory[place : place + section.size] = self._code[section.offset : section.offset + section.size]
        found: int | None = None
        for table in self._sections:
            if table.kind == RELA and table.info in self._places:
                self._relocate(table)
            if table.kind == SYMTAB:
                named = [s for s in self._symbols(table) if self._name(table, s[0]) == name]
                found = self._address(table, named[0]) if len(named) == 1 else None
        if found is None:
            raise ObjectError(f"object code must have one function '{name}'")
        libc = ctypes.CDLL(None, use_errno=True)
        size = ctypes.c_size_t(len(self._memory))
        if libc.mprotect(ctypes.c_void_p(self._base), size, mmap.PROT_READ | mmap.PROT_EXEC):
            raise OSError(ctypes.get_errno(), "mprotect")
        return Loaded(found, self._memory)

    def _section(self, at: int) -> _Section:
        _, kind, flags, _, offset, size, link, info, align, _ = struct.unpack_from("<IIQQQQIIQQ", self._code, at)
        if kind != NOBITS and offset + size > len(self._code):
            raise ObjectError("object code must be whole")
        return _Section(kind, flags, offset, size, link, info, align)

    def _symbols(self, table: _Section) -> list[tuple[int, ...]]:
        return list(struct.iter_unpack("<IBBHQQ", self._code[table.offset : table.offset + table.size]))

    def _name(self, table: _Section, at: int) -> str:
        begin = self._sections[table.link].offset + at
        return self._code[begin : self._code.index(b"\0", begin)].decode("ascii")

    def _relocate(self, table: _Section) -> None:
        target = self._places[table.info]
        symbol_table = self._sections[table.link]
        symbols = self._symbols(symbol_table)
        for offset, info, addend in struct.iter_unpack("<QQq", self._code[table.offset : table.offset + table.size]):
            value = self._address(symbol_table, symbols[info >> 32]) + addend
            place, kind = target + offset, info & 0xFFFFFFFF
            if kind == ABSOLUTE:
                struct.pack_into("<Q", self._memory, place, value)
            elif kind == RELATIVE_64:
                struct.pack_into("<q", self._memory, place, value - self._base - place)
            elif kind in {RELATIVE_32, CALL_32}:
                struct.pack_into("<i", self._memory, place, value - self._base - place)
            else:
                raise ObjectError(f"object code must have known relocations, got {kind}")

    def _address(self, table: _Section, symbol: tuple[int, ...]) -> int:
        name, _, _, section, value, _ = symbol
        if section in self._places:
            return self._base + self._places[section] + value
        if section != 0:
            raise ObjectError(f"object code refers to section {section}, which is not loaded")
        return _outside(self._name(table, name))


def _outside(name: str) -> int:
    """Return the address of a function of the system."""
    library = "libm.so.6" if name in MATHS else "libc.so.6"
    wanted = "abort" if name.startswith(NEVER) else name
    if wanted not in MATHS | MEMORY | {"abort"}:
        raise ObjectError(f"object code must do without '{name}'")
    address = ctypes.cast(getattr(ctypes.CDLL(library), wanted), ctypes.c_void_p).value
    if address is None:
        raise ObjectError(f"'{name}' is not there")
    return address
