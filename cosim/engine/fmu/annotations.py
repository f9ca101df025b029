"""What our own FMUs say of themselves beyond FMI: sample times, breakpoints, and names of numbered choices."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import isfinite
from pathlib import Path
from typing import TypeVar
from xml.etree import ElementTree

from flexfmu.cosim.engine.errors import FmuFileError
from flexfmu.fmu_build.choices import ANNOTATION
from flexfmu.fmu_build.naming import NAMES

Result = TypeVar("Result")


def sampling(path: Path, folder: Path) -> tuple[float, float] | None:
    """Sample time and offset [s] of an exported block; None for any other FMU.

    Args:
        path: the FMU file.
        folder: where it has been unpacked.

    Raises:
        FmuFileError: the annotation doesn't make sense.
    """
    return _read(path, folder, "Sampling", lambda at: (_number(at["sampleTime"]), _number(at["offset"])))


def breakpoints(path: Path, folder: Path) -> tuple[float, ...] | None:
    """Breakpoints [s] of an exported trajectory, ascending; None for any other FMU. Arguments as for `sampling`.

    Raises:
        FmuFileError: the annotation doesn't make sense.
    """
    return _read(path, folder, "Breakpoints", lambda at: tuple(map(_number, at["times"].split())))


def choices(path: Path, folder: Path) -> Mapping[str, Mapping[str, int]]:
    """Integer parameters whose values have names: parameter → name → value; none in any other FMU. Arguments as for
    `sampling`.

    Raises:
        FmuFileError: the annotation doesn't make sense.
    """
    return _read(path, folder, ANNOTATION, lambda at: {name: _numbered(text) for name, text in at.items()}) or {}


def names(path: Path, folder: Path) -> Mapping[str, str]:
    """Structured names of variables with flat ones: flat → structured; none in any other FMU. Arguments as for `sampling`."""
    return _read(path, folder, NAMES, dict) or {}


def _read(path: Path, folder: Path, element: str, parse: Callable[[dict[str, str]], Result]) -> Result | None:
    root = ElementTree.parse(folder / "modelDescription.xml")
    found = root.find(f"VendorAnnotations/Tool[@name='flexfmu']//{element}")
    if found is None:
        return None
    try:
        return parse(found.attrib)
    except (KeyError, ValueError) as error:
        raise FmuFileError(f"{path} is a broken FMU: its {element} are {found.attrib}; build it again") from error


def _number(text: str) -> float:
    value = float(text)
    if not isfinite(value):
        raise ValueError(text)
    return value


def _numbered(text: str) -> dict[str, int]:
    """``"static=1 undeformed=2"`` as a dictionary."""
    return {name: int(number) for name, _, number in (item.partition("=") for item in text.split())}
