"""FMUs of FMI 3.0 in the words of FMI 2.0, so that the same checks run both: a description, and the functions of a library.

Co-simulation uses event mode where the FMU has clocks: communication points are ticks of the fastest one, at which its variables are
set and read. Left out are arrays, Float32, binary variables, other clocked ones, clocks in model exchange and where one may tick within
these steps, event mode without clocks, time events and early return of co-simulation, and scheduled execution.
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

from flexfmu.fmu_build.fmi_clock import PERIODIC, TRIGGERED, read_clocks
from flexfmu.fmu_build.validation.finding import Finding
from flexfmu.fmu_build.validation.instance import MisbehaviourError, Watched, settled

_TYPES = {"Float64": "Real", "Boolean": "Boolean", "String": "String", "Enumeration": "Enumeration"} | {
    f"{sign}Int{bits}": "Integer" for sign in ("", "U") for bits in (8, 16, 32, 64)
}
"""Type of FMI 3.0 → type of FMI 2.0."""

_NEAR = 1e-6
"""Rounding of instants, relative to intervals."""

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
    clocks = _clocks(description, root)
    fastest = min(clocks.values(), default=0.0)
    ticking = {each for each, interval in clocks.items() if interval == fastest}
    kept = [v for v in description.modelVariables if v.type in _TYPES and not v.dimensions]
    kept = [v for v in kept if not v.clocks or ticking & {clock.valueReference for clock in v.clocks}]
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
    more = {"guid": description.guid, "fmiMajorVersion": 3, "types": types, "clocks": clocks}
    return SimpleNamespace(**asdict(description, recurse=False), **more)


def _clocks(description: Any, root: ElementTree.Element) -> dict[int, float]:
    """Value reference → interval [s] of the time-based clocks, multiples of one of them; empty for others, and without event mode."""
    if description.modelExchange or not getattr(description.coSimulation, "hasEventMode", False):
        return {}
    found = [each for each in read_clocks(root) if not each.is_output and each.variability != TRIGGERED]
    known = {each.reference: each.interval or 0.0 for each in found if each.variability in PERIODIC and not each.shift}
    fastest = min(known.values(), default=0.0)
    regular = fastest > 0.0 and all(_is_whole(each / fastest) for each in known.values())
    return known if regular and len(known) == len(found) else {}


def _is_whole(number: float) -> bool:
    return abs(number - round(number)) < _NEAR


class _FMU3(Watched, fmi3._FMU3):  # type: ignore[misc]
    """The functions that both interfaces have, called as those of FMI 2.0.

    Attributes:
        types: value reference → type of FMI 3.0.
        clocks: value reference → interval [s] of the clocks that tick.
    """

    types: dict[int, str]
    clocks: dict[int, float]

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
    """The functions for co-simulation, without early return; with clocks, Event Mode lasts from the end of a step to the next one."""

    _terminates, _last = False, math.nan

    def make(self, name: bytes, token: bytes, resources: bytes, log: Any) -> Any:
        update, none = fmi3.fmi3IntermediateUpdateCallback(), (fmi3.fmi3ValueReference * 0)()
        events = bool(self.clocks)
        return self.fmi3InstantiateCoSimulation(
            name, token, resources, False, False, events, False, none, 0, None, log, update
        )

    def doStep(self, time: float, length: float) -> None:
        """Make a step; raises `FMICallException` with fmi3Discard where the FMU terminates the simulation, as in FMI 2.0."""
        self._terminates = bool(self.clocks) and settled(self)[0]
        if not self._terminates:
            if self.clocks:
                self.enterStepMode()
            _, self._terminates, early, self._last = super().doStep(time, length)
            if early and not self._terminates:
                raise MisbehaviourError("fmi3DoStep returns early, though it must not", "make the whole step")
        if self._terminates:
            raise FMICallException("fmi3DoStep", fmi3.fmi3Discard)
        if self.clocks:
            self.enterEventMode()
            self._tick(time + length)

    def exitInitializationMode(self) -> None:
        super().exitInitializationMode()
        self._tick(self._experiment["startTime"])

    def _tick(self, time: float) -> None:
        """Activate the clocks that tick at ``time``, in Event Mode."""
        passed = time - self._experiment["startTime"]
        if due := [each for each, interval in self.clocks.items() if _is_whole(passed / interval)]:
            self.setClock(due, [True] * len(due))

    def getBooleanStatus(self, kind: int) -> bool:
        return bool(kind == fmi2.fmi2Terminated and self._terminates)

    def getRealStatus(self, kind: int) -> float:
        return float(self._last)


class FMU3ModelLibrary(_FMU3, fmi3.FMU3Model):  # type: ignore[misc]
    """The functions for model exchange."""

    def make(self, name: bytes, token: bytes, resources: bytes, log: Any) -> Any:
        return self.fmi3InstantiateModelExchange(name, token, resources, False, False, None, log)
