"""Built FMUs by content: what was built once is found again without CasADi and without a compiler.

This module must stay cheap to import; a cached build has to be decided in a tenth of a second.
"""

from __future__ import annotations

import hashlib
import os
from importlib.util import find_spec
from pathlib import Path

import platformdirs

from flexfmu.fmu_build.hashing import content_hash

FOLDER_VARIABLE = "FLEXFMU_CACHE"
"""Environment variable that names another folder for the cache."""

_PACKAGES = ("flexfmu.fmu_build", "flexfmu.model")
_SOURCE_SUFFIXES = {".py", ".c", ".h", ".j2", ".txt"}


def cache_folder() -> Path:
    """Where built FMUs are kept."""
    chosen = os.environ.get(FOLDER_VARIABLE)
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("flexfmu"))


def cached_fmu(key: str) -> Path:
    """Path of the FMU with this key, whether it is there or not."""
    return cache_folder() / f"{key}.fmu"


def package_fingerprint() -> str:
    """Hash of everything that turns a scene into an FMU: the sources of model and build."""
    files = (path for package in _PACKAGES for path in _source_files(package))
    return content_hash(part for path in files for part in (path.name.encode(), path.read_bytes()))


def digest_path(path: Path) -> Path:
    """Where the digest of a cached FMU is kept: beside it."""
    return path.with_suffix(".sha256")


def digest(content: bytes) -> bytes:
    """SHA-256 of an FMU, in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest().encode()


def read_intact(path: Path) -> bytes | None:
    """Content of a cached FMU; None where it is missing or not what was stored, so that it gets built again."""
    try:
        content, stored = path.read_bytes(), digest_path(path).read_bytes()
    except OSError:
        return None
    return content if digest(content) == stored else None


def _source_files(package: str) -> list[Path]:
    """Sources of a package in a fixed order, found without importing it."""
    spec = find_spec(package)
    roots = (spec.submodule_search_locations or []) if spec else []
    return sorted(path for root in roots for path in Path(root).rglob("*") if path.suffix in _SOURCE_SUFFIXES)
