"""What the archive holds beside description and binaries."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath
from xml.etree import ElementTree

from flexfmu.fmu_build.finding import Finding, Severity


def check_archive(files: Mapping[str, bytes]) -> Iterator[Finding]:
    """Findings about paths, sources and documentation.

    Args:
        files: content of the FMU, path inside → bytes.
    """
    yield from _check_documentation(files)
    for name in files:
        if "\\" in name or name.startswith("/") or ".." in PurePosixPath(name).parts:
            yield Finding("archive", f"the path {name} leaves the folder or has a backslash", "use a/b/c paths")
    listed = _names(files, "modelDescription.xml", "File") | _names(files, "sources/buildDescription.xml", "SourceFile")
    for file in sorted(listed):
        if f"sources/{file}" not in files:
            yield Finding("sources", f"sources/{file} is listed but missing", "add the file or drop the entry")


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
        yield Finding(
            "archive",
            f"documentation/ holds {pages[0]} but no index.html",
            "tools open documentation/index.html: add it",
            Severity.WARNING,
        )
