"""The symbols that a Linux shared library exports (ELF, 64 bit, little endian), read without any tool."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

_MAGIC = b"\x7fELF\x02\x01"
_SECTION_HEADERS = struct.Struct("<Q10xHHH")  # e_shoff at 40, then e_shentsize, e_shnum, e_shstrndx at 58
_SECTION = struct.Struct("<IIQQQQIIQQ")
_SYMBOL = struct.Struct("<IBBHQQ")
_DYNAMIC_SYMBOLS = 11
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


def exported_symbols(library: bytes) -> set[str]:
    """Names that the library defines and that are visible from outside.

    Raises:
        NotElfError: not an ELF file of this kind, or cut off.
    """
    if not library.startswith(_MAGIC):
        raise NotElfError("not a 64-bit ELF file")
    try:
        sections = list(_sections(library))
        tables = [section for section in sections if section.kind == _DYNAMIC_SYMBOLS]
        return {name for table in tables for name in _symbols(library, table, sections[table.link])}
    except (struct.error, IndexError, ValueError, OverflowError) as error:
        raise NotElfError("damaged ELF file") from error


def _sections(library: bytes) -> Iterator[_Section]:
    offset, size, count, _ = _SECTION_HEADERS.unpack_from(library, 40)
    for index in range(count):
        _, kind, _, _, start, length, link, *_ = _SECTION.unpack_from(library, offset + index * size)
        yield _Section(kind, start, length, link)


def _symbols(library: bytes, table: _Section, names: _Section) -> Iterator[str]:
    for position in range(table.offset, table.offset + table.size, _SYMBOL.size):
        name, info, other, section, _, _ = _SYMBOL.unpack_from(library, position)
        if section != _UNDEFINED and info >> 4 != _LOCAL and other & 3 not in _HIDDEN:
            start = names.offset + name
            yield library[start : library.index(b"\0", start)].decode()
