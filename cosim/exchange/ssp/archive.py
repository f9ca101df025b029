"""The zip archive of an SSP file, and the XML of the files within, both read safely.

Relative paths that lead out of the archive are errors. There are no entities, no network, no document type; errors name file, line and
element.
"""

from __future__ import annotations

import atexit
import hashlib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from math import isfinite
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit

from lxml import etree

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.variables import Value
from flexfmu.fmu_build.archive import DAMAGED, LARGEST_CONTENT, open_archive, read_member
from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.fmu_build.temporary import temporary_folder

DESCRIPTION = "SystemStructure.ssd"
"""Path of the default SSD in an SSP file."""

LARGEST_XML = 64_000_000
"""Largest XML file [bytes], unpacked: a thousand times the size of an SSD with a thousand connections."""

NAMESPACE = "http://ssp-standard.org/SSP1/"
"""How the names of all namespaces of SSP 1 begin."""

NAMESPACES = {
    "ssc": f"{NAMESPACE}SystemStructureCommon",
    "ssd": f"{NAMESPACE}SystemStructureDescription",
    "ssv": f"{NAMESPACE}SystemStructureParameterValues",
    "ssm": f"{NAMESPACE}SystemStructureParameterMapping",
}
"""The standard's prefixes."""

_ELEMENTS = ("System", "Component", "SignalDictionaryReference")
"""Elements of a system."""

_TYPES: dict[str, tuple[Callable[[str], Any], str]] = {
    "Real": (float, "a number"),
    "Integer": (int, "an integer"),
    "Boolean": ({"true": True, "1": True, "false": False, "0": False}.__getitem__, "true or false"),
}
"""Type → how a value is read, and what it must be; the others are texts."""


class SspError(InputError):
    """A file isn't SSP, contradicts the standard, or needs a feature that this program doesn't have."""


class SspArchive:
    """An SSP file.

    Args:
        path: path of the SSP file.
        description: path of the SSD within the archive; an SSP file may have variants of its default SSD.

    Attributes:
        path, description: the arguments.
        variants: paths of the other SSDs in the archive.

    Raises:
        SspError: the file is missing, is no zip archive, or doesn't contain the SSD.
    """

    def __init__(self, path: Path, description: str = DESCRIPTION) -> None:
        self.path, self.description = path, description
        try:
            self._archive = open_archive(path, "SSP")
        except ArchiveError as error:
            raise SspError(str(error)) from None
        # the SSD must exist; other SSDs are its variants
        self._entries = {entry.filename: entry for entry in self._archive.infolist()}
        self.variants = sorted({each for each in self._entries if each.endswith(".ssd")} - {description})
        if description not in self._entries:
            remedy = f"take another: --ssd {self.variants[0]}" if self.variants else "export it again"
            raise SspError(f"{path} is no SSP: it holds no {description}; {remedy}")

    def read(self, file: str, where: str = "", largest: int = LARGEST_XML) -> bytes:
        """Return the content of a file.

        Args:
            file: path within the archive.
            where: the referring element, for errors.
            largest: largest size [bytes].

        Raises:
            SspError: there is no such file, it is damaged or too large.
        """
        # the file must exist and be of reasonable size
        prefix = f"{where} names {file!r}, which" if where else f"{self.path.name}, {file}"
        if file not in self._entries:
            known = ", ".join(sorted(name for name in self._entries if not name.endswith("/")))
            raise SspError(f"{prefix} isn't in {self.path.name}; it holds: {known}")
        if self._entries[file].file_size > largest:
            raise SspError(f"{prefix} is {self._entries[file].file_size} bytes large; at most {largest} are read")
        try:
            return read_member(self._archive, self._entries[file])
        except DAMAGED as error:
            raise SspError(f"{prefix} can't be unpacked: {error}; export it again") from None

    def parse(self, file: str, root: str, where: str = "") -> XmlElement:
        """Return the root element of a file.

        Args:
            file: path within the archive.
            root: local name that the root element must have.
            where: the referring element, for errors.

        Raises:
            SspError: as for `read`; or it is no XML, has a document type declaration, or another root.
        """
        # no entities, no network
        parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
        label = f"{self.path.name}, {file}"
        try:
            element = etree.fromstring(_with_prefixes(self.read(file, where)), parser)
        except etree.XMLSyntaxError as error:
            raise SspError(f"{label} is no XML: {' '.join(str(error.msg).split())}; export it again") from None
        if element.getroottree().docinfo.doctype:
            raise SspError(f"{label} has a document type declaration, which SSP files don't need; remove the DOCTYPE")
        # the expected kind of file
        node = XmlElement(element, label)
        if node.tag != root or not (etree.QName(element).namespace or "").startswith(NAMESPACE):
            raise SspError(f"{label} begins with <{element.tag}>, must begin with <{root}> of SSP 1; check the file")
        return node

    def resolve(self, source: str, where: str) -> str:
        """Return the path within the archive of a ``source`` attribute.

        Args:
            source: URI relative to the SSD.
            where: the referring element, for errors.

        Raises:
            SspError: the URI is no relative path, or leads out of the archive.
        """
        # only plain relative paths
        uri = urlsplit(source)
        if uri.scheme or uri.netloc or uri.query or uri.fragment or not uri.path:
            raise SspError(
                f"{where} has source={source!r}; only files within the archive, resources/plant.fmu for example"
            )
        # resolve dots, but not beyond the top of the archive
        parts: list[str] = list(PurePosixPath(self.description).parent.parts)
        for part in unquote(uri.path).split("/"):
            if part == ".." and parts:
                parts.pop()
            elif part == "..":
                raise SspError(f"{where} has source={source!r}, which leads out of the archive; put the file inside")
            elif part not in ("", "."):
                parts.append(part)
        # no absolute paths, and no characters that an operating system reads as a separator or an end
        if uri.path.startswith("/") or any("\\" in part or "\0" in part for part in parts):
            raise SspError(f"{where} has source={source!r}; take a path relative to {self.description}, with slashes")
        return "/".join(parts)

    def extract(self, file: str, where: str) -> Path:
        """Copy a file to disk under a generated name, until the process ends, and return its path.

        Raises:
            SspError: as for `read`.
        """
        content = self.read(file, where, LARGEST_CONTENT)
        # a name without characters that an operating system could misread
        stem = "".join(c if c.isalnum() else "_" for c in PurePosixPath(file).stem)[:80] or "fmu"
        path = _folder() / hashlib.sha256(content).hexdigest()[:16] / f"{stem}.fmu"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return path


@cache
def _folder() -> Path:
    """Return the folder of all FMUs that this process extracts, removed at its end."""
    folder = temporary_folder("ssp")
    atexit.register(folder.cleanup)
    return Path(folder.name)


def _with_prefixes(content: bytes) -> bytes:
    """Return the document with declarations of the standard's prefixes, which some tools omit."""
    for prefix, uri in NAMESPACES.items():
        used, known = f"<{prefix}:".encode(), re.search(rf"xmlns:{prefix}\s*=".encode(), content)
        if used in content and not known:
            # on the first element, whatever it is called
            content = re.sub(
                rb"<([A-Za-z][\w.:-]*)", rb'<\1 xmlns:%s="%s"' % (prefix.encode(), uri.encode()), content, count=1
            )
    return content


@dataclass(frozen=True)
class XmlElement:
    """An element.

    Attributes:
        element: the element of lxml.
        file: its file, for errors.
    """

    element: Any
    file: str

    @property
    def tag(self) -> str:
        """Its name without namespace."""
        return str(etree.QName(self.element).localname)

    @property
    def where(self) -> str:
        """File, line and element, with the component or system that it belongs to, of a connection with its ends.

        Many tools write a whole file in one line.
        """
        name = self.element.get("name")
        around = [self, *(XmlElement(each, self.file) for each in self.element.iterancestors())]
        # the outermost system is the file's
        systems = [each.element.get("name") or "" for each in around[1:] if each.tag in _ELEMENTS][-2::-1]
        place = f" of {'.'.join(systems)!r}" if systems else ""
        for each in around:
            if each.tag == "Connection":
                ends = (
                    [each.element.get(f"{end}{part}") for part in ("Element", "Connector")] for end in ("start", "end")
                )
                place = " between " + " and ".join(repr(".".join(filter(None, [*systems, *end]))) for end in ends)
        return f"{self.file}, line {self.element.sourceline}: <{self.tag}{f' name={name!r}' if name else ''}>{place}"

    def error(self, problem: str) -> SspError:
        """The error that names this element."""
        return SspError(f"{self.where} {problem}")

    def text(self, attribute: str) -> str | None:
        """An attribute, None where it is missing."""
        value: str | None = self.element.get(attribute)
        return value

    def required(self, attribute: str) -> str:
        """An attribute.

        Raises:
            SspError: it is missing or empty.
        """
        value = self.text(attribute)
        if not value:
            raise self.error(f"lacks the attribute {attribute!r}; add it or export the file again")
        return value

    def value(self, kind: str, attribute: str) -> Value | None:
        """An attribute as a value of a type of SSP 1.0, None where it is missing.

        Raises:
            SspError: it is none of that type, or not finite.
        """
        text = self.text(attribute)
        if text is None or kind not in _TYPES:
            return text
        convert, what = _TYPES[kind]
        try:
            value: Value = convert(text.strip())
        except (ValueError, KeyError):
            raise self.error(f"has {attribute}={text!r}, which must be {what}") from None
        if isinstance(value, float) and not isfinite(value):
            raise self.error(f"has {attribute}={text!r}, which must be finite")
        return value

    def number(self, attribute: str) -> float | None:
        """A number, None where it is missing; errors as for `value`."""
        value = self.value("Real", attribute)
        return None if value is None else float(value)

    def children(self, *path: str) -> Iterator[XmlElement]:
        """Yield SSP elements below this one along a path of names; ``*`` matches every name."""
        head, *rest = path
        for child in self.element.iterchildren(etree.Element):
            name = etree.QName(child)
            if (name.namespace or "").startswith(NAMESPACE) and head in ("*", name.localname):
                node = XmlElement(child, self.file)
                yield from node.children(*rest) if rest else iter((node,))

    def child(self, *path: str) -> XmlElement | None:
        """The first of `children`."""
        return next(self.children(*path), None)

    def descendants(self, name: str) -> Iterator[XmlElement]:
        """Elements of that name below this one, whatever their namespace."""
        return (XmlElement(each, self.file) for each in self.element.iterfind(f".//{{*}}{name}"))
