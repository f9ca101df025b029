"""The base class of all errors of the package; each room has its own, which say what is wrong. And the text of a file from anybody, and
files that are written whole or not at all."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from stat import S_ISBLK, S_ISCHR, S_ISFIFO, S_ISREG
from threading import get_ident

LONGEST_MESSAGE, LONGEST_END = 800, 200
"""Largest number of characters of a message, which a name of a file's own choice would exceed, and of the end that it keeps."""

LARGEST_TABLE = 1_000_000_000
"""Largest CSV file [bytes]: two hours of twenty signals at a kilohertz; read, it takes some ten times its size."""

_BLOCK = 1 << 20


class Error(Exception):
    """Something can't be done as asked; the message is one line that names what, where, the value and a remedy."""

    def __str__(self) -> str:
        """Return the message, shortened in the middle where it is long."""
        return shortened(super().__str__())


def shortened(text: str) -> str:
    """The text without its middle where it has more than `LONGEST_MESSAGE` characters."""
    if len(text) <= LONGEST_MESSAGE:
        return text
    return f"{text[: LONGEST_MESSAGE - LONGEST_END]} ... {text[-LONGEST_END:]}"


def read_text(path: str | Path, largest: int = LARGEST_TABLE) -> str:
    """The text of a UTF-8 file, without its byte-order mark; line ends stay as they are.

    Raises:
        OSError: as for `read_bytes`.
        UnicodeDecodeError: it is no UTF-8 text.
    """
    return read_bytes(path, largest).decode("utf-8-sig")


def read_bytes(path: str | Path, largest: int = LARGEST_TABLE) -> bytearray:
    """The content of a file.

    Args:
        path: a file, or a pipe.
        largest: largest size [bytes].

    Raises:
        OSError: it can't be read, is a device, or is larger; ``strerror`` has the reason.
    """
    # opening a pipe that nothing writes into would wait for ever
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | getattr(os, "O_NONBLOCK", 0))) as file:
        # a device may never end, and a pipe neither
        status = os.fstat(file.fileno())
        if S_ISFIFO(status.st_mode):
            os.set_blocking(file.fileno(), True)
        if S_ISCHR(status.st_mode) or S_ISBLK(status.st_mode):
            raise OSError(errno.EINVAL, "it is a device; give a file", str(path))
        content = bytearray()
        if not S_ISREG(status.st_mode) or status.st_size <= largest:
            while len(content) <= largest and (block := file.read(_BLOCK)):
                content += block
        if len(content) > largest or status.st_size > largest:
            raise OSError(errno.EFBIG, f"it is larger than {largest / 1e6:g} MB, the most that is read", str(path))
        if S_ISFIFO(status.st_mode) and not content:
            raise OSError(errno.EINVAL, "it is a pipe that nothing writes into, no regular file", str(path))
    return content


PART = ".part"
"""Ending of a file that isn't whole yet, beside the one that it will replace; one of a process that was killed stays."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a path beside ``path``, which it replaces when the context ends without an error: no process reads half a file.

    Folders that are missing are made; none of them stays empty.

    Raises:
        OSError: the folder can't be made, or the file can't be replaced.
    """
    temporary = path.parent / f".{path.name}.{os.getpid()}-{get_ident()}{PART}"
    made: list[Path] = []
    try:
        made = make_folder(path.parent)
        yield temporary
        temporary.replace(path)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        remove_empty(made)


def make_folder(path: Path) -> list[Path]:
    """Make a folder unless it is there; those that were missing on the way to it, from the deepest up.

    Raises:
        OSError: it can't be made.
    """
    missing = [each for each in (path, *path.parents) if not each.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError:
        remove_empty(missing)
        raise
    return missing


def remove_empty(folders: list[Path]) -> None:
    """Remove folders, up to the first one that isn't empty."""
    with suppress(OSError):
        for each in folders:
            each.rmdir()
