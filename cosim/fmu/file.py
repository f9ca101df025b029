"""FMU files: unpacked once per content, described, and checked for what a slave needs."""

from __future__ import annotations

import atexit
import hashlib
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import fmpy
from fmpy.model_description import Item, SimpleType, read_model_description

from flexfmu.cosim.errors import FmuFileError
from flexfmu.cosim.fmu.annotations import choices, names


@dataclass(frozen=True)
class UnpackedFmu:
    """An FMU on disk, ready to be loaded; equal to any with the same content.

    Attributes:
        path: the FMU file.
        folder: where FMUs with that content have been unpacked; gone when the process ends.
        description: model description as fmpy reads it.
    """

    path: Path = field(compare=False)
    folder: Path
    description: Any = field(compare=False)

    @property
    def is_ours(self) -> bool:
        """Whether this package made it."""
        return str(self.description.generationTool).startswith("flexfmu ")


def open_fmu(path: Path) -> UnpackedFmu:
    """Unpack an FMI 2.0 co-simulation FMU, or find it unpacked from an earlier time.

    Raises:
        FmuFileError: it is missing, broken, of another kind, or has no binary for this platform.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FmuFileError(f"can't read the FMU {path}: {error.strerror}; check the path") from error
    folder, description = _unpack(hashlib.sha256(content).hexdigest(), path)
    _check(path, folder, description)
    return UnpackedFmu(path, folder, description)


@cache
def _root() -> Path:
    """Folder of all unpacked FMUs of this process, removed at its end."""
    folder = tempfile.TemporaryDirectory(prefix="flexfmu-", ignore_cleanup_errors=True)
    atexit.register(folder.cleanup)
    return Path(folder.name)


_unpacked: dict[str, tuple[Path, Any]] = {}
"""Content hash → folder and model description, so that the same FMU is unpacked and parsed once."""


def _unpack(digest: str, path: Path) -> tuple[Path, Any]:
    """Folder and model description of the FMU with that content."""
    if digest not in _unpacked:
        folder = _root() / digest
        attempt(path, lambda: fmpy.extract(str(path), unzipdir=str(folder)))
        description = attempt(path, lambda: read_model_description(str(folder), validate=False))
        if str(description.generationTool).startswith("flexfmu "):
            _restore_names(description, names(path, folder))
            _name_choices(description, choices(path, folder))
        _unpacked[digest] = folder, description
    return _unpacked[digest]


def _restore_names(description: Any, structured: Mapping[str, str]) -> None:
    """Give the variables of our own FMUs with flat names the structured ones, so that they connect like any others."""
    for variable in description.modelVariables:
        variable.name = structured.get(variable.name, variable.name)


def _name_choices(description: Any, names: Mapping[str, Mapping[str, int]]) -> None:
    """Give the numbered choices of our own FMUs their names, as enumerations have them in their types."""
    for variable in description.modelVariables:
        if variable.name in names:
            items = [Item(name, str(value)) for name, value in names[variable.name].items()]
            variable.declaredType = SimpleType(variable.name, type=variable.type, items=items)


def attempt(path: Path, action: Callable[[], Any]) -> Any:
    """Do something with fmpy, whose errors are of many kinds."""
    try:
        return action()
    except zipfile.BadZipFile:
        raise FmuFileError(f"{path} is no FMU: not a zip file; build it again or check the path") from None
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FmuFileError(f"{path} is a broken FMU: {reason}; `flexfmu validate` tells more") from error


def _check(path: Path, folder: Path, description: Any) -> None:
    """Version, kind and platform."""
    if not description.fmiVersion.startswith("2."):
        raise FmuFileError(
            f"{path} is an FMU of FMI {description.fmiVersion}; this program runs FMI 2.0: export it for that"
        )
    if description.coSimulation is None:
        raise FmuFileError(f"{path} is for model exchange only; export it for co-simulation")
    identifier = description.coSimulation.modelIdentifier
    library = folder / "binaries" / fmpy.platform / (identifier + fmpy.sharedLibraryExtension)
    if not library.is_file():
        platforms = sorted(each.name for each in (folder / "binaries").glob("*") if each.is_dir())
        found = ", ".join(platforms) or "none"
        raise FmuFileError(f"{path} has no binary for {fmpy.platform} (it has: {found}); build it for this platform")
