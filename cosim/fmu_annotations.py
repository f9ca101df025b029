"""What our own FMUs say of themselves beyond FMI: sample times and breakpoints."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite
from typing import TypeVar
from xml.etree import ElementTree

from flexfmu.cosim.errors import FmuFileError
from flexfmu.cosim.fmu_file import UnpackedFmu

Result = TypeVar("Result")


def sampling(fmu: UnpackedFmu) -> tuple[float, float] | None:
    """Sample time and offset [s] of an exported block; None for any other FMU.

    Raises:
        FmuFileError: the annotation doesn't make sense.
    """
    return _read(fmu, "Sampling", lambda at: (_number(at["sampleTime"]), _number(at["offset"])))


def breakpoints(fmu: UnpackedFmu) -> tuple[float, ...] | None:
    """Breakpoints [s] of an exported trajectory, ascending; None for any other FMU.

    Raises:
        FmuFileError: the annotation doesn't make sense.
    """
    return _read(fmu, "Breakpoints", lambda at: tuple(map(_number, at["times"].split())))


def _read(fmu: UnpackedFmu, element: str, parse: Callable[[dict[str, str]], Result]) -> Result | None:
    root = ElementTree.parse(fmu.folder / "modelDescription.xml")
    found = root.find(f"VendorAnnotations/Tool[@name='flexfmu']/{element}")
    if found is None:
        return None
    try:
        return parse(found.attrib)
    except (KeyError, ValueError) as error:
        raise FmuFileError(f"{fmu.path} is a broken FMU: its {element} are {found.attrib}; build it again") from error


def _number(text: str) -> float:
    value = float(text)
    if not isfinite(value):
        raise ValueError(text)
    return value
