"""FMUs of FMI 3.0 in the words of FMI 2.0, so that the same checks run both: a description, and the functions of a library.

Left out are arrays, Float32, binary and clocked variables, event mode and early return of co-simulation, and scheduled execution.
"""

from __future__ import annotations

import math
import re
from ctypes import POINTER, c_uint8, cast
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

from attrs import asdict
from fmpy import fmi2, fmi3
from fmpy.fmi1 import FMICallException
from fmpy.model_description import read_model_description

from flexfmu.fmu_build.validation.finding import Finding
from flexfmu.fmu_build.validation.instance import MisbehaviourError, Watched

_TYPES = {"Float64": "Real", "Boolean": "Boolean", "String": "String", "Enumeration": "Enumeration"} | {
    f"{sign}Int{bits}": "Integer" for sign in ("", "U") for bits in (8, 16, 32, 64)
}
"""Type of FMI 3.0 → type of FMI 2.0."""

_NAMES = {
    "GetReal": "GetFloat64",
    "SetReal": "SetFloat64",
    "GetInteger": "GetInt32",
    "NewDiscreteStates": "UpdateDiscreteStates",
    "GetDerivatives": "GetContinuousStateDerivatives",
    "GetRealOutputDerivatives": "GetOutputDerivatives",
}
"""Function of FMI 2.0 → function of FMI 3.0 with the same meaning, without their prefix; others have the same name."""


def in_fmi3(finding: Finding) -> Finding:
    """The finding with the names of FMI 3.0."""
    message, remedy = (_renamed(text).replace("GUID", "token") for text in (finding.message, finding.remedy))
    return replace(finding, message=message, remedy=remedy, section="FMI 3.0")


def _renamed(text: str) -> str:
    text = text.replace("FMUstate", "FMUState").replace("DeSerialize", "Deserialize")
    return re.sub(r"\bfmi2(\w+)", lambda match: f"fmi3{_NAMES.get(match[1], match[1])}", text)


def described(folder: Path) -> Any:
    """The description of an extracted FMU as read by fmpy; of FMI 3.0 what FMI 2.0 has words for."""
    description = read_model_description(folder, validate=False)
    if description.fmiMajorVersion != 3:
        return description
    # what fmpy leaves out
    root = ElementTree.parse(folder / "modelDescription.xml").getroot()
    claims = {each.tag for each in root if each.get("providesDirectionalDerivatives") in ("true", "1")}
    for element in filter(None, (description.coSimulation, description.modelExchange)):
        element.providesDirectionalDerivative = type(element).__name__ in claims
    # scalars of the types that there are in FMI 2.0
    kept = [v for v in description.modelVariables if v.type in _TYPES and not v.dimensions and not v.clocks]
    types = {variable.valueReference: variable.type for variable in kept}
    for variable in kept:
        variable.type = _TYPES[variable.type]
    references = {variable.valueReference for variable in kept}
    for name in ("outputs", "derivatives", "initialUnknowns"):
        unknowns = getattr(description, name)
        known = [unknown for unknown in unknowns if unknown.variable.valueReference in references]
        # states are set all together: without one of them there is none
        setattr(description, name, known if name != "derivatives" or len(known) == len(unknowns) else [])
    description.modelVariables = kept
    return SimpleNamespace(**asdict(description, recurse=False), guid=description.guid, fmiMajorVersion=3, types=types)


class _FMU3(Watched, fmi3._FMU3):  # type: ignore[misc]
    """The functions that both interfaces have, called as those of FMI 2.0; ``types``: value reference → type of FMI 3.0."""

    types: dict[int, str]

    def setupExperiment(self, **experiment: Any) -> None:
        self._experiment = experiment

    def enterInitializationMode(self) -> None:
        super().enterInitializationMode(**self._experiment)

    def getInteger(self, references: list[int]) -> list[int]:
        return [getattr(self, f"get{self._integer(each)}")([each])[0] for each in references]

    def setInteger(self, references: list[int], values: list[int]) -> None:
        for each, value in zip(references, values, strict=True):
            getattr(self, f"set{self._integer(each)}")([each], [value])

    def _integer(self, reference: int) -> str:
        return self.types.get(reference, "Int32").replace("Enumeration", "Int64")

    def fmi2GetReal(self, component: Any, references: Any, count: int, values: Any) -> Any:
        return self.fmi3GetFloat64(component, references, count, values, count)

    def fmi2SerializeFMUstate(self, component: Any, state: Any, data: Any, size: int) -> Any:
        return self.fmi3SerializeFMUState(component, state, cast(data, POINTER(c_uint8)), size)

    def __getattr__(self, name: str) -> Any:
        """A function that differs by its name alone: getReal, fmi2FreeInstance."""
        new = _renamed(name if name.startswith("fmi2") else f"fmi2{name[:1].upper()}{name[1:]}")
        new = new if name.startswith("fmi2") else new[4:5].lower() + new[5:]
        if new == name:
            raise AttributeError(name)
        return getattr(self, new)


class FMU3SlaveLibrary(_FMU3, fmi3.FMU3Slave):  # type: ignore[misc]
    """The functions for co-simulation, without event mode and early return."""

    _terminates, _last = False, math.nan

    def make(self, name: bytes, token: bytes, resources: bytes, log: Any) -> Any:
        update = fmi3.fmi3IntermediateUpdateCallback()
        return self.fmi3InstantiateCoSimulation(
            name, token, resources, False, False, False, False, (fmi3.fmi3ValueReference * 0)(), 0, None, log, update
        )

    def doStep(self, time: float, length: float) -> None:
        """Make a step; raises `FMICallException` with fmi3Discard where the FMU terminates the simulation, as in FMI 2.0."""
        self._terminates = False
        _, self._terminates, early, self._last = super().doStep(time, length)
        if early and not self._terminates:
            raise MisbehaviourError("fmi3DoStep returns early, though it must not", "make the whole step")
        if self._terminates:
            raise FMICallException("fmi3DoStep", fmi3.fmi3Discard)

    def getBooleanStatus(self, kind: int) -> bool:
        return bool(kind == fmi2.fmi2Terminated and self._terminates)

    def getRealStatus(self, kind: int) -> float:
        return float(self._last)


class FMU3ModelLibrary(_FMU3, fmi3.FMU3Model):  # type: ignore[misc]
    """The functions for model exchange."""

    def make(self, name: bytes, token: bytes, resources: bytes, log: Any) -> Any:
        return self.fmi3InstantiateModelExchange(name, token, resources, False, False, None, log)
