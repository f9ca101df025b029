"""XML of SSP files, read safely: no entities, no network, no document type; errors name file, line and element."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from typing import Any

from lxml import etree

from flexfmu.cosim.exchange.ssp.structure import SspError

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

_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}


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
        """File, line and element, with the component or system that it belongs to, of a connection with its ends."""
        name = self.element.get("name")
        label = f"<{self.tag}{f' name={name!r}' if name else ''}>"
        return f"{self.file}, line {self.element.sourceline}: {label}{self._place}"

    @property
    def _place(self) -> str:
        """The component, system or connection around the element, since many tools write a whole file in one line."""
        around = [self, *(XmlElement(each, self.file) for each in self.element.iterancestors())]
        # the outermost system is the file's
        systems = [each.element.get("name") or "" for each in around[1:] if each.tag in _ELEMENTS][-2::-1]
        connection = next((each for each in around if each.tag == "Connection"), None)
        if connection is None:
            return f" of {'.'.join(systems)!r}" if systems else ""
        ends = (
            ".".join(
                filter(None, [*systems, *(connection.element.get(f"{end}{part}") for part in ("Element", "Connector"))])
            )
            for end in ("start", "end")
        )
        return f" between {' and '.join(map(repr, ends))}"

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

    def number(self, attribute: str) -> float | None:
        """A number, None where it is missing.

        Raises:
            SspError: it is no finite number.
        """
        text = self.text(attribute)
        try:
            value = None if text is None else float(text)
        except ValueError:
            raise self.error(f"has {attribute}={text!r}, which must be a number") from None
        if value is not None and not isfinite(value):
            raise self.error(f"has {attribute}={text!r}, which must be finite")
        return value

    def integer(self, attribute: str) -> int | None:
        """An integer, None where it is missing.

        Raises:
            SspError: it is no integer.
        """
        text = self.text(attribute)
        try:
            return None if text is None else int(text)
        except ValueError:
            raise self.error(f"has {attribute}={text!r}, which must be an integer") from None

    def boolean(self, attribute: str, default: bool = False) -> bool:
        """A boolean.

        Raises:
            SspError: it is none.
        """
        text = self.text(attribute)
        if text is not None and text.strip() not in _BOOLEANS:
            raise self.error(f"has {attribute}={text!r}, which must be true or false")
        return default if text is None else _BOOLEANS[text.strip()]

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


def parse(content: bytes, file: str, root: str) -> XmlElement:
    """The root element.

    Args:
        content: the XML.
        file: its name, for errors.
        root: local name that the root element must have.

    Raises:
        SspError: it is no XML, has a document type declaration, or another root.
    """
    # no entities, no network
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
    try:
        element = etree.fromstring(_with_prefixes(content), parser)
    except etree.XMLSyntaxError as error:
        raise SspError(f"{file} is no XML: {' '.join(str(error.msg).split())}; export it again") from None
    if element.getroottree().docinfo.doctype:
        raise SspError(f"{file} has a document type declaration, which SSP files don't need; remove the DOCTYPE")
    # the expected kind of file
    node = XmlElement(element, file)
    if node.tag != root or not (etree.QName(element).namespace or "").startswith(NAMESPACE):
        raise SspError(f"{file} begins with <{element.tag}>, must begin with <{root}> of SSP 1; check the file")
    return node


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
