"""Reproducible zip archives, checked reading of archives from anywhere, and atomic writing of files."""

from __future__ import annotations

import io
import lzma
import re
import zipfile
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from stat import S_ISREG

from flexfmu.errors import replacing
from flexfmu.fmu_build.errors import ArchiveError

_EPOCH = (1980, 1, 1, 0, 0, 0)
_UNIX = 3
_MODES = {".so": 0o755, ".dylib": 0o755, ".dll": 0o755}
_FILE_MODE = 0o644

LARGEST_CONTENT = 8_000_000_000
"""Largest content of an archive, unpacked [bytes]: an FMU of 500 MB unpacks to 1 to 2 GB, and temporary folders are often smaller."""

LARGEST_RATIO, ANY_RATIO = 100, 64_000_000
"""Largest ratio of unpacked to packed size, and content below which any ratio is taken [bytes]: libraries and texts are packed to a
third or a tenth, tables to a fiftieth; a bomb to a thousandth."""

MOST_MEMBERS = 30_000
"""Most members of an archive: an FMU with a whole Python distribution has 20,000."""

LARGEST_DESCRIPTION = 300_000_000
"""Largest model description [bytes]: of an FMU with a million variables."""

_LINK = 0o120000

_BLOCK = 1 << 20
"""Bytes that are unpacked at once."""

DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    NotImplementedError,
    RuntimeError,
    EOFError,
    OSError,
    ValueError,
)
"""Exceptions of Python's zip reader for an archive or member that is damaged, encrypted or packed by an unknown method."""


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


def open_archive(path: Path, kind: str = "FMU", judged: bool = False) -> zipfile.ZipFile:
    """Open a zip archive that may come from anybody, after its sizes and names have been checked by its central directory.

    Args:
        path: the file.
        kind: what it should be, for errors: FMU or SSP.
        judged: open it although a member has an unsafe name, which the caller judges by `unsafe`.

    Raises:
        ArchiveError: the file is missing or none, no zip archive, unpacks to more than the limits of this module, or has an
            unsafe member.
    """
    try:
        # neither a device nor a pipe, which may never end
        status = path.stat()
        archive = zipfile.ZipFile(path if S_ISREG(status.st_mode) else io.BytesIO())
    except OSError as error:
        raise ArchiveError(f"can't read the {kind} {str(path)[:200]}: {error.strerror}; check the path") from error
    except DAMAGED:
        raise ArchiveError(f"{path} is no {kind}: not a zip file; build it again or check the path") from None
    size = status.st_size
    members = archive.infolist()
    content = sum(each.file_size for each in members)
    problem = next((found for each in members if (found := unsafe(each))), "") if not judged else ""
    if not judged and not problem and (twice := repeated(members)):
        problem = f"holds {next(iter(twice))[:80]!r} twice, of which tools take any"
    if len(members) > MOST_MEMBERS:
        problem = f"holds {len(members)} files; at most {MOST_MEMBERS} are read"
    elif content > LARGEST_CONTENT:
        problem = f"unpacks to {content / 1e9:.1f} GB; at most {LARGEST_CONTENT / 1e9:g} GB are read"
    elif content > max(ANY_RATIO, LARGEST_RATIO * size):
        problem = f"unpacks to {content / size:.0f} times its size, {content / 1e6:.0f} MB; at most {LARGEST_RATIO} times are read"
    elif any(each.filename == "modelDescription.xml" and each.file_size > LARGEST_DESCRIPTION for each in members):
        problem = f"has a model description of more than {LARGEST_DESCRIPTION / 1e6:g} MB"
    if problem:
        archive.close()
        raise ArchiveError(f"{path} {problem}; export it again, or don't trust it")
    return archive


def files_in(path: Path, folder: str) -> dict[str, bytes]:
    """The files in a folder of an FMU: path below the folder → content.

    Raises:
        ArchiveError: the FMU can't be read.
    """
    try:
        with open_archive(path) as archive:
            names = [each for each in archive.namelist() if each.startswith(f"{folder}/") and not each.endswith("/")]
            return {name.removeprefix(f"{folder}/"): archive.read(name) for name in names}
    except DAMAGED as error:
        raise ArchiveError(f"can't read the {folder} of {path}: {error}") from error


def unsafe(member: zipfile.ZipInfo) -> str:
    """What makes a member of an archive unsafe to unpack; empty if nothing does."""
    # Python's zip reader cuts a name at a zero
    name = member.orig_filename
    parts = name.replace("\\", "/").split("/")
    if ".." in parts or parts[0] == "" or name[1:2] == ":" or "\0" in name:
        return f"holds {name[:80]!r}, which leaves its folder"
    if member.external_attr >> 16 & 0o170000 == _LINK:
        return f"holds {name[:80]!r}, a symbolic link"
    return ""


def repeated(members: Sequence[zipfile.ZipInfo]) -> dict[str, int]:
    """Paths of files that are there more than once, however they are spelt (``a//b`` is ``a/b``), and how often."""
    counts = Counter(str(PurePosixPath(each.filename)) for each in members if not each.is_dir())
    return {path: count for path, count in counts.items() if count > 1}


def read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """The content of a member, unpacked block by block, so that one that is longer than it says ends at its stated size.

    Raises:
        BadZipFile: its checksum is wrong, as that of a member of another size is; or another of `DAMAGED`.
    """
    with archive.open(member) as stream:
        return b"".join(iter(lambda: stream.read(_BLOCK), b""))


def write_atomically(path: Path, content: bytes) -> None:
    """Write ``content`` to a temporary file, then rename it to ``path``, so that no process reads an incomplete file.

    Raises:
        ArchiveError: the folder can't be made or written, or ``path`` is a folder.
    """
    try:
        if path.is_dir():
            raise ArchiveError(f"cannot write {path}: it is a folder; give the name of a file")
        with replacing(path) as temporary:
            temporary.write_bytes(content)
            temporary.chmod(_FILE_MODE)
    except OSError as error:
        message = f"cannot write {path}: {error.strerror}; choose a writable folder with free space"
        raise ArchiveError(message) from error


def fmu_facts(content: bytes) -> tuple[str, int]:
    """GUID of an FMU that this package has built, and the size of its generated C code [bytes]."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        description = archive.read("modelDescription.xml").decode()
        sizes = [e.file_size for e in archive.infolist() if re.fullmatch(r"sources/model_\w+\.[ch]", e.filename)]
    guid = re.search(r'\b(?:guid|instantiationToken)="([^"]*)"', description)
    return guid.group(1) if guid else "", sum(sizes)
