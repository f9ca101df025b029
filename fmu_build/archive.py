"""Reproducible zip archives, and atomic writing of files."""

from __future__ import annotations

import io
import os
import re
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

from flexfmu.fmu_build.errors import ArchiveError

_EPOCH = (1980, 1, 1, 0, 0, 0)
_UNIX = 3
_MODES = {".so": 0o755, ".dylib": 0o755, ".dll": 0o755}
_FILE_MODE = 0o644


def pack(files: Mapping[str, bytes]) -> bytes:
    """A zip archive of ``files`` (path → content), sorted, with fixed times and permissions, so that its bytes are reproducible."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for path in sorted(files):
            entry = zipfile.ZipInfo(path, _EPOCH)
            entry.create_system = _UNIX
            entry.external_attr = _MODES.get(Path(path).suffix, _FILE_MODE) << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, files[path])
    return buffer.getvalue()


def write_atomically(path: Path, content: bytes) -> None:
    """Write ``content`` to a temporary file, then rename it to ``path``, so that no process reads an incomplete file.

    Raises:
        ArchiveError: the folder can't be made or written, or ``path`` is a folder.
    """
    # a temporary file in the same folder: renaming within one file system is atomic
    try:
        if path.is_dir():
            raise ArchiveError(f"cannot write {path}: it is a folder; give the name of a file")
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise _cannot_write(path, error) from error
    try:
        # remove the temporary file if writing fails
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        os.chmod(temporary, _FILE_MODE)
        os.replace(temporary, path)
    except OSError as error:
        Path(temporary).unlink(missing_ok=True)
        raise _cannot_write(path, error) from error


def _cannot_write(path: Path, error: OSError) -> ArchiveError:
    return ArchiveError(f"cannot write {path}: {error.strerror}; choose a writable folder with free space")


def fmu_facts(content: bytes) -> tuple[str, int]:
    """GUID of an FMU that this package has built, and the size of its generated C code [bytes]."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        description = archive.read("modelDescription.xml").decode()
        sizes = [e.file_size for e in archive.infolist() if re.fullmatch(r"sources/model_\w+\.[ch]", e.filename)]
    guid = re.search(r'\bguid="([^"]*)"', description)
    return guid.group(1) if guid else "", sum(sizes)
