"""Cache of what is expensive: FMUs, object files, libraries, matrices, by content hash; a cached FMU needs neither CasADi nor a compiler.

Beside each file is its seal, a hash of its name and its content: what is damaged, or was stored under another name, isn't used. The
folder belongs to its user alone, and has a limit: what was used longest ago is removed first.

This module must be cheap to import: finding a cached FMU must not take more than a tenth of a second.
"""

from __future__ import annotations

import atexit
import os
import re
import time
import warnings
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from typing import NamedTuple

import platformdirs

from flexfmu.fmu_build.archive import write_atomically
from flexfmu.fmu_build.errors import ArchiveError, CacheWarning, SettingError
from flexfmu.fmu_build.temporary import temporary_folder

FOLDER_VARIABLE, LIMIT_VARIABLE = "FLEXFMU_CACHE", "FLEXFMU_CACHE_LIMIT"
"""Environment variables that name another folder for the cache, and the most that it may take [MB]."""

USUAL_LIMIT = 1000.0
"""The most that the cache takes where no variable says otherwise [MB]."""

BLOCK = 4096
"""Files take a multiple of this on the disk [bytes]."""

SLACK = 0.05
"""Part of the limit that is removed beyond need, and stored between two looks at the size."""

IN_USE = 60.0
"""What was stored or used in this time is about to be loaded, and stays [s]; what an ended process has used counts as older."""

_SEAL = ".seal"
"""Ending of the files with the hashes."""

_TALLY = "stored-since"
"""File that has grown by a byte for each block that was stored since the size was looked at."""

_HASHED = re.compile(r"\.?[0-9a-f]{64}(\.\S+)?")
"""Name of a file of the cache; also of one that was being written when its process was killed."""

_PACKAGES = ("flexfmu.fmu_build", "flexfmu.model")
_SOURCE_SUFFIXES = {".py", ".c", ".h", ".j2", ".txt"}

_used: set[Path] = set()
"""Files that this process has stored or read."""

_stand_ins: dict[Path, TemporaryDirectory[str]] = {}
"""Folders that can't be used → temporary folders that replace them until the process ends."""
_stand_ins_lock = Lock()


def cache_folder() -> Path:
    """Folder of the cache; a temporary folder where the chosen one could not be written, or isn't this user's alone.

    Warns:
        CacheWarning: the folder belongs to another user, or others can write to it; a temporary folder replaces it.

    Raises:
        ArchiveError: there is no temporary folder either.
    """
    folder = _chosen_folder()
    if folder not in _stand_ins and (reason := _distrust(folder)):
        _replace(folder, ArchiveError(reason))
    return Path(_stand_ins[folder].name) if folder in _stand_ins else folder


def _distrust(folder: Path) -> str:
    """Why a folder isn't used though it could be: what is in it is run; empty where nothing speaks against it."""
    if os.name != "posix":
        return ""
    try:
        facts = folder.stat()
    except OSError:
        return ""  # there is none, or writing will tell
    if facts.st_uid != os.geteuid():
        return f"it belongs to user {facts.st_uid}, and this is user {os.geteuid()}"
    return "others can write to it; `chmod go-w` on it if you trust what is there" if facts.st_mode & 0o022 else ""


def read_cached(name: str) -> bytes | None:
    """Content of a file in the cache, which counts as used; None if it is missing, inaccessible, damaged or another one's."""
    path = cache_folder() / name
    try:
        content, seal = path.read_bytes(), _seal_of(path).read_bytes()
    except OSError:
        return None
    if seal != _seal(name, content):
        return None
    with suppress(OSError):  # a folder that can't be written
        os.utime(path)
        _use(path)
    return content


def cached(name: str) -> Path | None:
    """Path of a file in the cache; None where `read_cached` finds none."""
    return None if read_cached(name) is None else cache_folder() / name


def store(name: str, content: bytes) -> Path:
    """Write a file into the cache and return its path.

    Warns:
        CacheWarning: the folder can't be written; a temporary folder replaces it until the process ends.

    Raises:
        ArchiveError: the temporary folder can't be written either.
    """
    folder = cache_folder()
    try:
        return _store(folder, name, content)
    except ArchiveError as error:
        _replace(folder, error)
        return _store(cache_folder(), name, content)


def _store(folder: Path, name: str, content: bytes) -> Path:
    """Write a file and its seal into a folder, and see to its limit; errors as for `write_atomically`."""
    path, seal = folder / name, _seal(name, content)
    make_private(folder)
    if path.parent != folder:
        make_private(path.parent)
        with suppress(OSError):  # one that was made with another mode
            path.parent.chmod(0o700)
    write_atomically(path, content)
    write_atomically(_seal_of(path), seal)
    _use(path)
    with suppress(OSError):
        with (folder / _TALLY).open("ab") as tally:
            tally.write(bytes((_taken(len(content)) + BLOCK) // BLOCK))
            much = tally.tell() * BLOCK > SLACK * cache_limit()
        if much:
            _trim(folder)
    return path


def make_private(folder: Path) -> None:
    """Make the cache's folder, for this user alone, unless there is one or none can be made."""
    with suppress(OSError):
        if not folder.parent.exists():
            make_private(folder.parent)
        folder.mkdir(mode=0o700)
        folder.chmod(0o700)  # whatever the umask


class Cached(NamedTuple):
    """A file in the cache.

    Attributes:
        used: when it was used last [s since 1970].
        size: what it takes on the disk with its seal [bytes].
        path: of the file.
    """

    used: float
    size: int
    path: Path


def cached_files() -> list[Cached]:
    """All files in the cache; nothing that others have put beside them."""
    return [*_files(cache_folder())]


def _files(folder: Path) -> Iterator[Cached]:
    for path in folder.rglob("*"):
        seal = _seal_of(path)
        with suppress(OSError):  # another process has removed it
            if path.name.endswith(_SEAL):
                if not path.with_suffix("").exists():
                    yield Cached(path.stat().st_mtime, BLOCK, path)
            elif seal.exists() or _HASHED.fullmatch(path.name):
                facts = path.stat()
                yield Cached(facts.st_mtime, _taken(facts.st_size) + BLOCK, path)


def _trim(folder: Path) -> None:
    """Remove what was used longest ago, until the folder takes less than its limit; not what is about to be loaded."""
    (folder / _TALLY).unlink(missing_ok=True)
    found = sorted(_files(folder))
    excess = sum(each.size for each in found) - (1.0 - SLACK) * cache_limit()
    for each in found:
        if excess <= 0.0 or each.used > time.time() - IN_USE:
            return
        remove_cached(each)
        excess -= each.size


def _use(path: Path) -> None:
    """Keep a file in the cache until this process ends."""
    if not _used:
        atexit.register(_leave)
    _used.add(path)


def _leave() -> None:
    """At the end of the process hold the limit, but for what it has used, which may go from then on.

    Only after something was stored, or where a variable says what the limit is: a look at all files takes time.
    """
    folder = _chosen_folder()
    with suppress(OSError, SettingError):
        for age in (0.0, IN_USE):
            moment = time.time() - age
            for path in _used:
                with suppress(OSError):
                    os.utime(path, (moment, moment))
            if not age and ((folder / _TALLY).exists() or LIMIT_VARIABLE in os.environ):
                _trim(folder)


def remove_cached(file: Cached) -> None:
    """Remove a file from the cache, with its seal."""
    for path in (file.path, _seal_of(file.path)):
        with suppress(OSError):
            path.unlink()


def cache_limit() -> float:
    """The most that the cache takes [bytes].

    Raises:
        SettingError: the variable isn't a number of megabytes.
    """
    stated = os.environ.get(LIMIT_VARIABLE) or USUAL_LIMIT
    try:
        limit = 1e6 * float(stated)
    except ValueError:
        limit = -1.0
    if not limit >= 0.0:
        raise SettingError(
            f"{LIMIT_VARIABLE} is the most that the cache takes in MB, got {str(stated)[:40]!r}; 1000 is usual"
        )
    return limit


def _seal_of(path: Path) -> Path:
    return path.with_name(f"{path.name}{_SEAL}")


def _seal(name: str, content: bytes) -> bytes:
    """Hash of a name and its content, as hexadecimal digits."""
    return content_hash([Path(name).as_posix().encode(), content]).encode()


def _taken(size: int) -> int:
    """What a file of a size takes on the disk [bytes]."""
    return -(-size // BLOCK) * BLOCK


@cache
def package_fingerprint() -> str:
    """Hash of the package's sources that turn a scene into an FMU: model and build; read once in a process."""
    files = (path for package in _PACKAGES for path in _source_files(package))
    return content_hash(part for path in files for part in (path.name.encode(), path.read_bytes()))


def _chosen_folder() -> Path:
    """The folder in the environment variable, else the user's cache folder of the system."""
    chosen = os.environ.get(FOLDER_VARIABLE)
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("flexfmu"))


def _replace(folder: Path, error: ArchiveError) -> None:
    """Replace a folder that can't be used by a temporary one, with a warning.

    Raises:
        ArchiveError: the folder is already a temporary one, or none can be made.
    """
    # only one thread replaces the folder
    with _stand_ins_lock:
        if folder != _chosen_folder():
            raise error
        if folder in _stand_ins:  # another thread was faster
            return
        try:
            _stand_ins[folder] = temporary_folder("cache")
        except OSError:
            raise error from None
    warnings.warn(
        f"cannot use the cache's folder {folder} ({getattr(error.__cause__, 'strerror', None) or error}): what is built "
        f"is gone when this process ends; name a writable folder of your own with free space in the variable {FOLDER_VARIABLE}",
        CacheWarning,
        stacklevel=3,
    )


def _source_files(package: str) -> list[Path]:
    """Source files of a package, sorted, found without importing it."""
    spec = find_spec(package)
    roots = (spec.submodule_search_locations or []) if spec else []
    return sorted(path for root in roots for path in Path(root).rglob("*") if path.suffix in _SOURCE_SUFFIXES)


def content_hash(parts: Iterable[bytes]) -> str:
    """Hexadecimal SHA-256 of a list of byte strings, including their lengths, so that different splits differ."""
    digest = sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()
