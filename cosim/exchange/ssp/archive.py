"""The zip archive of an SSP file; relative paths that lead out of the archive are errors."""

from __future__ import annotations

import atexit
import hashlib
import lzma
import tempfile
import zipfile
import zlib
from functools import cache
from io import BytesIO
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlsplit

from flexfmu.cosim.exchange.ssp.structure import SspError

DESCRIPTION = "SystemStructure.ssd"
"""Path of the default SSD in an SSP file."""

LARGEST_XML = 64_000_000
"""Largest XML file [bytes], unpacked: a thousand times the size of an SSD with a thousand connections."""

LARGEST_FMU = 4_000_000_000
"""Largest FMU within the archive [bytes]."""

DAMAGED = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, RuntimeError, EOFError, OSError, ValueError)
"""Exceptions of Python's zip reader for an entry that is damaged, encrypted or compressed by an unknown method."""


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
            self._content = path.read_bytes()
            self._archive = zipfile.ZipFile(BytesIO(self._content))
        except OSError as error:
            raise SspError(f"can't read {path}: {error.strerror}; check the path") from error
        except (zipfile.BadZipFile, NotImplementedError):
            raise SspError(f"{path} is no SSP: not a zip file; check the path or export it again") from None
        # the SSD must exist; other SSDs are its variants
        self._entries = {entry.filename: entry for entry in self._archive.infolist()}
        self.variants = sorted({each for each in self._entries if each.endswith(".ssd")} - {description})
        if description not in self._entries:
            remedy = f"take another: --ssd {self.variants[0]}" if self.variants else "export it again"
            raise SspError(f"{path} is no SSP: it holds no {description}; {remedy}")

    def label(self, file: str) -> str:
        """Return the name of a file within the archive, for errors."""
        return f"{self.path.name}, {file}"

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
        prefix = f"{where} names {file!r}, which" if where else self.label(file)
        if file not in self._entries:
            known = ", ".join(sorted(name for name in self._entries if not name.endswith("/")))
            raise SspError(f"{prefix} isn't in {self.path.name}; it holds: {known}")
        if self._entries[file].file_size > largest:
            raise SspError(f"{prefix} is {self._entries[file].file_size} bytes large; at most {largest} are read")
        try:
            with self._archive.open(file) as stream:
                return stream.read(largest)
        except DAMAGED as error:
            raise SspError(f"{prefix} can't be unpacked: {error}; export it again") from None

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
        content = self.read(file, where, LARGEST_FMU)
        path = _folder() / hashlib.sha256(content).hexdigest()[:16] / f"{_safe(PurePosixPath(file).stem)}.fmu"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return path


def _safe(name: str) -> str:
    """Return the name with all characters but letters and digits replaced by underscores, at most 80 characters."""
    return "".join(c if c.isalnum() else "_" for c in name)[:80] or "fmu"


@cache
def _folder() -> Path:
    """Return the folder of all FMUs that this process extracts, removed at its end."""
    folder = tempfile.TemporaryDirectory(prefix="flexfmu-ssp-", ignore_cleanup_errors=True)
    atexit.register(folder.cleanup)
    return Path(folder.name)
