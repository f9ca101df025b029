"""Temporary folders that carry the name of their process, so that those of a process that was killed are removed by a later one.

    flexfmu-SPACE-PROCESS-PURPOSE-RANDOM

SPACE stands for this machine and its process identifiers: a container beside this one, or another machine with the same folder of
temporary files, has processes of its own.
"""

from __future__ import annotations

import os
import platform
import shutil
import stat
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from weakref import finalize
from zlib import crc32

PREFIX = "flexfmu-"


def temporary_folder(purpose: str, within: Path | None = None) -> TemporaryDirectory[str]:
    """A new temporary folder, removed at the latest when this process ends, or by a later process if this one is killed.

    Args:
        purpose: what it is for, a word of its name.
        within: folder to make it in; None for the system's (or that of the variable TMPDIR).

    Raises:
        OSError: it can't be made.
    """
    where = within or Path(tempfile.gettempdir())
    _remove_stale(where)
    mine = f"{PREFIX}{_space()}-{os.getpid()}-{purpose}-"
    folder = TemporaryDirectory(prefix=mine, dir=where, ignore_cleanup_errors=True)
    finalize(folder, _remove_rest, folder.name)
    return folder


def _remove_rest(folder: str) -> None:
    """Remove what `shutil.rmtree` leaves where there are too few file descriptors: it takes one for each level, this one for all."""
    for where, folders, files in os.walk(folder, topdown=False):
        for remove, names in ((os.unlink, files), (os.rmdir, folders)):
            for name in names:
                with suppress(OSError):
                    remove(os.path.join(where, name))
    with suppress(OSError):
        os.rmdir(folder)


@cache
def _space() -> str:
    """This machine and its name space of process identifiers, eight hexadecimal digits."""
    identifiers = Path("/proc/self/ns/pid")
    inode = identifiers.stat().st_ino if identifiers.exists() else 0
    return f"{crc32(f'{platform.node()} {inode}'.encode()):08x}"


@cache
def _remove_stale(where: Path) -> None:
    """Remove what dead processes of this user have left in a folder; once in a process."""
    if os.name != "posix":  # where a signal can't ask whether a process lives
        return
    with suppress(OSError), os.scandir(where) as entries:
        for entry in entries:
            space, _, rest = entry.name.removeprefix(PREFIX).partition("-")
            process = rest.partition("-")[0]
            if not entry.name.startswith(PREFIX) or space != _space() or not process.isdecimal():
                continue
            facts = entry.stat(follow_symlinks=False)
            if stat.S_ISDIR(facts.st_mode) and facts.st_uid == os.geteuid() and not _is_alive(int(process)):
                shutil.rmtree(entry.path, ignore_errors=True)


def _is_alive(process: int) -> bool:
    """Whether there is a process of this identifier, whoever's it is."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True
