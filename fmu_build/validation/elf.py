"""What a Linux shared library exports and needs (ELF, 64 bit, little endian), read without any tool."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass

_MAGIC = b"\x7fELF\x02\x01"
_SECTION_HEADERS = struct.Struct("<Q10xHHH")  # e_shoff at 40, then e_shentsize, e_shnum, e_shstrndx at 58
_SECTION = struct.Struct("<IIQQQQIIQQ")
_SYMBOL = struct.Struct("<IBBHQQ")
_ENTRY = struct.Struct("<qQ")
_DYNAMIC_SYMBOLS = 11
_DYNAMIC = 6
_VERSIONS_NEEDED = 0x6FFFFFFE
_NEEDED, _RPATH, _RUNPATH = 1, 15, 29
_UNDEFINED = 0
_LOCAL = 0
_HIDDEN = {1, 2}


class NotElfError(ValueError):
    """The bytes are no 64-bit little-endian ELF file, or a damaged one."""


@dataclass(frozen=True)
class _Section:
    kind: int
    offset: int
    size: int
    link: int


@dataclass(frozen=True)
class ElfFacts:
    """What matters of a library to those who load it.

    Attributes:
        exports: names that it defines and that are visible from outside.
        needed: names of the libraries that it needs.
        search_path: folders where it looks for them first (RPATH, RUNPATH).
        glibc: oldest version of the C library that will do, (0, 0) if it needs none.
    """

    exports: frozenset[str]
    needed: tuple[str, ...]
    search_path: tuple[str, ...]
    glibc: tuple[int, int]


def read_elf(library: bytes) -> ElfFacts:
    """Facts about a shared library.

    Raises:
        NotElfError: not an ELF file of this kind, or cut off.
    """
    if not library.startswith(_MAGIC):
        raise NotElfError("not a 64-bit ELF file")
    try:
        sections = list(_sections(library))
        entries = [entry for section in _of_kind(sections, _DYNAMIC) for entry in _entries(library, section, sections)]
        symbols = _of_kind(sections, _DYNAMIC_SYMBOLS)
        return ElfFacts(
            exports=frozenset(name for table in symbols for name in _symbols(library, table, sections[table.link])),
            needed=tuple(text for tag, text in entries if tag == _NEEDED),
            search_path=tuple(
                path for tag, text in entries if tag in (_RPATH, _RUNPATH) for path in text.split(":") if path
            ),
            glibc=_glibc(library, sections),
        )
    except (struct.error, IndexError, ValueError, OverflowError) as error:
        raise NotElfError("damaged ELF file") from error


def exported_symbols(library: bytes) -> set[str]:
    """Names that the library defines and that are visible from outside.

    Raises:
        NotElfError: not an ELF file of this kind, or cut off.
    """
    return set(read_elf(library).exports)


def _of_kind(sections: list[_Section], kind: int) -> list[_Section]:
    return [section for section in sections if section.kind == kind]


def _entries(library: bytes, table: _Section, sections: list[_Section]) -> Iterator[tuple[int, str]]:
    """The dynamic section's entries that hold a text: (tag, text)."""
    names = sections[table.link].offset
    for position in range(table.offset, table.offset + table.size, _ENTRY.size):
        tag, value = _ENTRY.unpack_from(library, position)
        if tag in (_NEEDED, _RPATH, _RUNPATH):
            yield tag, _text(library, names + value)


def _glibc(library: bytes, sections: list[_Section]) -> tuple[int, int]:
    """The newest ``GLIBC_x.y`` among the names of needed versions."""
    newest = (0, 0)
    for section in _of_kind(sections, _VERSIONS_NEEDED):
        names = sections[section.link]
        text = library[names.offset : names.offset + names.size]
        for major, minor in re.findall(rb"\0GLIBC_(\d+)\.(\d+)", text):
            newest = max(newest, (int(major), int(minor)))
    return newest


def _text(library: bytes, start: int) -> str:
    return library[start : library.index(b"\0", start)].decode()


def _sections(library: bytes) -> Iterator[_Section]:
    offset, size, count, _ = _SECTION_HEADERS.unpack_from(library, 40)
    for index in range(count):
        _, kind, _, _, start, length, link, *_ = _SECTION.unpack_from(library, offset + index * size)
        yield _Section(kind, start, length, link)


def _symbols(library: bytes, table: _Section, names: _Section) -> Iterator[str]:
    for position in range(table.offset, table.offset + table.size, _SYMBOL.size):
        name, info, other, section, _, _ = _SYMBOL.unpack_from(library, position)
        if section != _UNDEFINED and info >> 4 != _LOCAL and other & 3 not in _HIDDEN:
            yield _text(library, names.offset + name)
