"""The base class of all errors of the package; each room has its own, which say what is wrong. And the text of a file from anybody."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from stat import S_ISBLK, S_ISCHR, S_ISREG

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
    with open(path, "rb") as file:
        # a device may never end, and a pipe neither
        status = os.fstat(file.fileno())
        if S_ISCHR(status.st_mode) or S_ISBLK(status.st_mode):
            raise OSError(errno.EINVAL, "it is a device; give a file", str(path))
        content = bytearray()
        if not S_ISREG(status.st_mode) or status.st_size <= largest:
            while len(content) <= largest and (block := file.read(_BLOCK)):
                content += block
        if len(content) > largest or status.st_size > largest:
            raise OSError(errno.EFBIG, f"it is larger than {largest / 1e6:g} MB, the most that is read", str(path))
    return content
