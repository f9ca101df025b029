"""The FMU's zip archive: how it is written, and what it holds besides description and binaries."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree

from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.fmu_build.validation.finding import Finding, Severity

FOLDERS = {"binaries", "documentation", "extra", "licenses", "resources", "sources", "terminalsAndIcons"}
"""Folders of an FMU 2.0, and what later versions of the standard or of tools add."""

FILES = {"modelDescription.xml", "model.png"}

_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
_LINK = 0o120000
_FLAGS, _ENCRYPTED = 6, 1
"""Where the flags are in the header before each file of an archive, and the one for encryption."""

_PNG = b"\x89PNG\r\n\x1a\n"


def read_archive(path: Path) -> tuple[list[zipfile.ZipInfo], dict[str, bytes], list[str]]:
    """Directory and content of the archive, path inside → bytes, and paths whose own header says that they are encrypted.

    Every entry is read, so its checksum is checked.

    Raises:
        ArchiveError: the file is missing, no zip archive, damaged, or has no modelDescription.xml.
    """
    try:
        content = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError) as error:
        raise ArchiveError(
            f"no FMU at {path}; build one with: flexfmu build SCENE -o {path.name or 'NAME.fmu'}"
        ) from error
    except OSError as error:
        raise ArchiveError(f"cannot read the FMU {path}: {error.strerror}; check its permissions") from error
    try:
        # each entry, in full: the archive's directory alone doesn't show damage
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = archive.infolist()
            files = {entry.filename: archive.read(entry) for entry in entries if not entry.is_dir()}
            encrypted = [entry.filename for entry in entries if content[entry.header_offset + _FLAGS] & _ENCRYPTED]
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError, RuntimeError) as error:
        raise ArchiveError(f"{path} is no intact FMU (zip archive): {error}; build it again") from error
    if "modelDescription.xml" not in files:
        # the usual mistakes: a folder too much, or another spelling
        nested = next((name for name in files if name.endswith("/modelDescription.xml")), None)
        where = f": it is at {nested}, pack the content of that folder" if nested else ""
        other = next((name for name in files if name.lower() == "modeldescription.xml"), None)
        where = f": it is called {other}, rename it" if other else where
        raise ArchiveError(f"{path} is a zip archive but no FMU: modelDescription.xml is missing{where}")
    return entries, files, encrypted


def unpack(files: dict[str, bytes], folder: Path) -> None:
    """Write the files that an FMU may need to run."""
    (folder / "resources").mkdir(parents=True)
    for name, content in files.items():
        path = PurePosixPath(name.replace("\\", "/"))
        if not path.is_absolute() and ".." not in path.parts and path.parts[0] != "sources":
            target = folder / path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)


def check_entries(entries: list[zipfile.ZipInfo], encrypted: Sequence[str] = ()) -> Iterator[Finding]:
    """Findings about how the zip file is written.

    Args:
        entries: its directory.
        encrypted: paths of the files that are encrypted by what stands before them.
    """
    # files that tools cannot read, or read differently
    for name in encrypted:
        yield _archive(f"{name} is marked as encrypted in its own header", "pack it without a password", name)
    for name, count in Counter(entry.filename for entry in entries).items():
        if count > 1:
            yield _archive(f"{name} is there {count} times", "keep one: tools take any of them", name)
    # paths, methods and kinds of entries
    for entry in entries:
        name = entry.filename
        if "\\" in entry.orig_filename or name.startswith("/") or ".." in PurePosixPath(name).parts or name[1:2] == ":":
            yield _archive(
                f"{entry.orig_filename} leaves the folder or has a backslash", "use a/b/c paths", entry.orig_filename
            )
        if entry.compress_type not in _METHODS:
            yield _archive(
                f"{name} is packed by method {entry.compress_type}", "use deflate, most tools know no other", name
            )
        if entry.external_attr >> 16 & 0o170000 == _LINK:
            yield _archive(f"{name} is a symbolic link", "put the file there: most tools unpack its path as text", name)
    # names that are one on other systems
    alike = Counter(entry.filename.rstrip("/").lower() for entry in entries)
    for entry in entries:
        if alike[entry.filename.rstrip("/").lower()] > 1 and entry.filename != entry.filename.lower():
            message = f"{entry.filename} differs from another path in upper and lower case only"
            yield _archive(message, "Windows and macOS keep one of them", entry.filename, Severity.WARNING)


def check_archive(files: Mapping[str, bytes]) -> Iterator[Finding]:
    """Findings about files, sources and documentation.

    Args:
        files: content of the FMU, path inside → bytes.
    """
    # files that tools never look at
    for name in files:
        first, *rest = PurePosixPath(name).parts or ("",)
        if (rest and first not in FOLDERS) or (not rest and first not in FILES):
            known = {each.lower(): each for each in FOLDERS | FILES}
            remedy = f"call it {known[first.lower()]}" if first.lower() in known else "put it into resources or extra"
            yield _archive(f"{name} is where no tool looks", remedy, name, Severity.WARNING)
    yield from _check_documentation(files)
    if "model.png" in files and not files["model.png"].startswith(_PNG):
        yield _archive("model.png is no PNG picture", "convert it", "", Severity.WARNING)
    # sources that the description or the build description lists
    listed = _names(files, "modelDescription.xml", "File") | _names(files, "sources/buildDescription.xml", "SourceFile")
    for file in sorted(listed):
        path = f"sources/{PurePosixPath(file)}"
        if path not in files:
            yield Finding("sources", f"{path} is listed but missing", "add the file or drop the entry", subject=path)
        elif not files[path].strip():
            yield Finding("sources", f"{path} is empty", "add its content", Severity.WARNING, path)


def _archive(message: str, remedy: str, subject: str, severity: Severity = Severity.ERROR) -> Finding:
    return Finding("archive", message, remedy, severity, subject)


def _names(files: Mapping[str, bytes], path: str, element: str) -> set[str]:
    """The attributes ``name`` of all elements of a kind in an XML file; none where it is missing or broken."""
    try:
        return {
            item.attrib.get("name", "") for item in ElementTree.fromstring(files.get(path, b"<none/>")).iter(element)
        }
    except ElementTree.ParseError:
        return set()


def _check_documentation(files: Mapping[str, bytes]) -> Iterator[Finding]:
    """A folder of documentation needs its entry point (FMI 2.0.4, section 2.3)."""
    pages = [name for name in files if name.startswith("documentation/")]
    if pages and "documentation/index.html" not in files:
        message, remedy = (
            f"documentation/ holds {pages[0]} but no index.html",
            "tools open documentation/index.html: add it",
        )
        yield _archive(message, remedy, "", Severity.WARNING)
