"""Cache of built FMUs and object files, by content hash; a cached FMU needs neither CasADi nor a compiler.

This module must be cheap to import: finding a cached FMU must not take more than a tenth of a second.
"""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Iterable
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock

import platformdirs

from flexfmu.fmu_build.archive import write_atomically
from flexfmu.fmu_build.errors import ArchiveError, CacheWarning

FOLDER_VARIABLE = "FLEXFMU_CACHE"
"""Environment variable that names another folder for the cache."""

_PACKAGES = ("flexfmu.fmu_build", "flexfmu.model")
_SOURCE_SUFFIXES = {".py", ".c", ".h", ".j2", ".txt"}

_stand_ins: dict[Path, TemporaryDirectory[str]] = {}
"""Folders that can't be written → temporary folders that replace them until the process ends."""
_stand_ins_lock = Lock()


def cache_folder() -> Path:
    """Folder of the cache; a temporary folder after the chosen one could not be written."""
    folder = _chosen_folder()
    return Path(_stand_ins[folder].name) if folder in _stand_ins else folder


def cached(name: str) -> Path | None:
    """Path of a file in the cache; None if it is missing or inaccessible."""
    path = cache_folder() / name
    try:
        return path if path.is_file() else None
    except OSError:
        return None


def store(name: str, content: bytes) -> Path:
    """Write a file into the cache and return its path.

    Warns:
        CacheWarning: the folder can't be written; a temporary folder replaces it until the process ends.

    Raises:
        ArchiveError: the temporary folder can't be written either.
    """
    folder = cache_folder()
    try:
        write_atomically(folder / name, content)
    except ArchiveError as error:
        _replace(folder, error)
        folder = cache_folder()
        write_atomically(folder / name, content)
    return folder / name


@cache
def package_fingerprint() -> str:
    """Hash of the package's sources that turn a scene into an FMU: model and build; read once in a process."""
    files = (path for package in _PACKAGES for path in _source_files(package))
    return content_hash(part for path in files for part in (path.name.encode(), path.read_bytes()))


def digest_name(name: str) -> str:
    """File name of a cached FMU's digest, in the same folder."""
    return f"{Path(name).stem}.sha256"


def digest(content: bytes) -> bytes:
    """SHA-256 of an FMU as hexadecimal digits."""
    return hashlib.sha256(content).hexdigest().encode()


def read_intact(path: Path) -> bytes | None:
    """Content of a cached FMU; None if it is missing or damaged."""
    try:
        content, stored = path.read_bytes(), path.with_name(digest_name(path.name)).read_bytes()
    except OSError:
        return None
    return content if digest(content) == stored else None


def _chosen_folder() -> Path:
    """The folder in the environment variable, else the user's cache folder of the system."""
    chosen = os.environ.get(FOLDER_VARIABLE)
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("flexfmu"))


def _replace(folder: Path, error: ArchiveError) -> None:
    """Replace a folder that can't be written by a temporary one, with a warning.

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
            _stand_ins[folder] = TemporaryDirectory(prefix="flexfmu-cache-", ignore_cleanup_errors=True)
        except OSError:
            raise error from None
    warnings.warn(
        f"cannot write to the cache's folder {folder} ({getattr(error.__cause__, 'strerror', None) or error}): what is built "
        f"is gone when this process ends; name a writable folder with free space in the variable {FOLDER_VARIABLE}",
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
