"""Checks of the FMU's zip archive, and of files other than description and binaries."""

from __future__ import annotations

import os
import re
import shutil
import zipfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree

from flexfmu.fmu_build.archive import DAMAGED, open_archive, read_member, repeated, unsafe
from flexfmu.fmu_build.errors import ArchiveError, CompileError, MissingCompilerError
from flexfmu.fmu_build.temporary import temporary_folder
from flexfmu.fmu_build.toolchain import CompileJob, find_compiler, fmi_header_folder, native_platform
from flexfmu.fmu_build.validation.finding import Finding, Severity

FOLDERS = {"binaries", "documentation", "extra", "licenses", "resources", "sources", "terminalsAndIcons"}
"""Folders of an FMU 2.0, and of later versions of the standard."""

FILES = {"modelDescription.xml", "model.png"}

UNREAD = ("resources/", "extra/")
"""Folders whose files no check looks into."""

_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
_FLAGS, _ENCRYPTED = 6, 1
"""Offset of the flags in a local file header, and the flag for encryption (PKWARE APPNOTE, 4.3.7 and 4.4.4)."""

_PNG = b"\x89PNG\r\n\x1a\n"


def read_archive(path: Path) -> tuple[list[zipfile.ZipInfo], dict[str, bytes], list[str]]:
    """Read the archive: its entries, path → content, and the paths whose local header has the encryption flag.

    Reading every entry verifies its checksum. Of files in `UNREAD`, which may be large, the content stays empty.

    Raises:
        ArchiveError: the file is missing, no zip archive, damaged, or has no modelDescription.xml.
    """
    if not path.exists() or path.is_dir():
        raise ArchiveError(f"no FMU at {path}; build one with: flexfmu build SCENE -o {path.name or 'NAME.fmu'}")
    # read each member in full: the central directory alone doesn't reveal damage
    with open_archive(path, judged=True) as archive:
        entries = archive.infolist()
        try:
            files = {entry.filename: _content(archive, entry) for entry in entries if not entry.is_dir()}
            encrypted = [entry.filename for entry in entries if _flags(archive, entry) & _ENCRYPTED]
        except DAMAGED as error:
            raise ArchiveError(f"{path} is no intact FMU (zip archive): {error}; build it again") from error
    if "modelDescription.xml" not in files:
        # usual mistakes: an extra folder level, or another spelling
        where = ""
        for name in files:
            if name.endswith("/modelDescription.xml"):
                where = f": it is at {name}, pack the content of that folder"
            elif name.lower() == "modeldescription.xml":
                where = f": it is called {name}, rename it"
        raise ArchiveError(f"{path} is a zip archive but no FMU: modelDescription.xml is missing{where}")
    return entries, files, encrypted


def _content(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bytes:
    """The content of an entry; empty for one in `UNREAD`, whose checksum is verified."""
    if not entry.filename.startswith(UNREAD):
        return read_member(archive, entry)
    with archive.open(entry) as stream, Path(os.devnull).open("wb") as nowhere:
        shutil.copyfileobj(stream, nowhere)
    return b""


def _flags(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> int:
    """The first byte of the flags in a member's local header."""
    assert archive.fp is not None
    archive.fp.seek(entry.header_offset + _FLAGS)
    return archive.fp.read(1)[0]


def unpack(fmu: Path, folder: Path, sources: bool = False) -> None:
    """Write the FMU's files, without unsafe paths, to ``folder``: all but sources, or these alone.

    The folder has an empty resources folder if the FMU has none.
    """
    (folder / "resources").mkdir(parents=True)
    with open_archive(fmu, judged=True) as archive:
        for entry in archive.infolist():
            path = PurePosixPath(entry.filename.replace("\\", "/"))
            is_safe = not entry.is_dir() and not path.is_absolute() and ".." not in path.parts
            if is_safe and (path.parts[0] == "sources") == sources:
                target = folder / path
                target.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(entry) as packed, target.open("wb") as file:
                    shutil.copyfileobj(packed, file)


def check_entries(entries: list[zipfile.ZipInfo], encrypted: Sequence[str] = ()) -> Iterator[Finding]:
    """Yield findings about the entries of the zip file.

    Args:
        entries: entries of the central directory.
        encrypted: paths whose local header has the encryption flag.
    """
    # encrypted files and repeated paths
    for name in encrypted:
        yield Finding(f"{name} is marked as encrypted in its own header", "pack it without a password", subject=name)
    for name, count in repeated(entries).items():
        yield Finding(f"{name} is there {count} times", "keep one: tools take any of them", subject=name)
    # paths, symbolic links, compression methods, names that differ only by case
    alike = Counter(entry.filename.rstrip("/").lower() for entry in entries)
    for entry in entries:
        name, original = entry.filename, entry.orig_filename
        if problem := unsafe(entry):
            yield Finding(f"the archive {problem}", "use a/b/c paths and whole files", subject=original)
        elif "\\" in original:
            yield Finding(f"{original} has a backslash", "use a/b/c paths", subject=original)
        if entry.compress_type not in _METHODS:
            message = f"{name} is packed by method {entry.compress_type}"
            yield Finding(message, "use deflate, most tools know no other", subject=name)
        if alike[name.rstrip("/").lower()] > 1 and name != name.lower():
            message = f"{name} differs from another path in upper and lower case only"
            yield Finding(message, "Windows and macOS keep one of them", Severity.WARNING, name)


def check_archive(files: Mapping[str, bytes]) -> Iterator[Finding]:
    """Yield findings about files, sources and documentation.

    Args:
        files: path inside the FMU → content.
    """
    # files outside the standard's folders
    for name in files:
        first, *rest = PurePosixPath(name).parts or ("",)
        if (rest and first not in FOLDERS) or (not rest and first not in FILES):
            known = {each.lower(): each for each in FOLDERS | FILES}
            remedy = f"call it {known[first.lower()]}" if first.lower() in known else "put it into resources or extra"
            yield Finding(f"{name} is where no tool looks", remedy, Severity.WARNING, name)
    # the entry point of the documentation (FMI 2.0.4, section 2.3)
    pages = [name for name in files if name.startswith("documentation/")]
    if pages and "documentation/index.html" not in files:
        message = f"documentation/ holds {pages[0]} but no index.html"
        yield Finding(message, "tools open documentation/index.html: add it", Severity.WARNING)
    if "model.png" in files and not files["model.png"].startswith(_PNG):
        yield Finding("model.png is no PNG picture", "convert it", Severity.WARNING)
    # sources listed in the description or the build description
    listed = _names(files, "modelDescription.xml", "File") | _names(files, "sources/buildDescription.xml", "SourceFile")
    for file in sorted(listed):
        path = f"sources/{PurePosixPath(file)}"
        if path not in files:
            yield Finding(
                f"{path} is listed but missing", "add the file or drop the entry", subject=path, check="sources"
            )
        elif not files[path].strip():
            yield Finding(f"{path} is empty", "add its content", Severity.WARNING, path, check="sources")


def check_sources(description: Any, fmu: Path) -> Iterator[Finding]:
    """Yield a finding if the C sources of a build configuration don't compile here; nothing where there is no compiler.

    Args:
        description: model description as read by fmpy.
        fmu: the FMU file.
    """
    sets = [each for configuration in description.buildConfigurations for each in configuration.sourceFileSets]
    with temporary_folder("validate") as home, suppress(MissingCompilerError):
        unpack(fmu, folder := Path(home) / "fmu", sources=True)
        for each in sets:
            names = [name for name in each.sourceFiles if name.endswith(".c") and (folder / "sources" / name).exists()]
            flags = [f"-I{path}" for path in (fmi_header_folder(), ".", *each.includeDirectories)]
            flags += [f"-D{one.name}={one.value or ''}" for one in each.preprocessorDefinitions if not one.optional]
            try:
                # to objects, since `zig cc` fails with -fsyntax-only
                jobs = [CompileJob(name, ("-O0", "-w", *flags)) for name in names]
                find_compiler(native_platform()).compile(jobs, folder / "sources")
            except CompileError as error:
                # a header of another library or system is no fault
                severity = Severity.NOTE if re.search("No such file|not found", str(error)) else Severity.WARNING
                yield Finding(str(error), "correct the sources: tools compile them for other machines", severity)
                return


def _names(files: Mapping[str, bytes], path: str, element: str) -> set[str]:
    """The attributes ``name`` of all elements with a tag in an XML file; empty if the file is missing or malformed."""
    try:
        root = ElementTree.fromstring(files.get(path, b"<none/>"))
    except (ElementTree.ParseError, LookupError, ValueError):  # of an encoding, too; fmpy's rules report it
        return set()
    return {item.attrib.get("name", "") for item in root.iter(element)}
