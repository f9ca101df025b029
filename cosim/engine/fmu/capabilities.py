"""What an FMU can do with derivatives and steps, as far as its model description says."""

from __future__ import annotations

from functools import cache
from math import inf
from xml.etree import ElementTree

from flexfmu.cosim.engine.errors import FmuFileError
from flexfmu.cosim.engine.fmu.file import UnpackedFmu

INTERPOLATION_ORDER = 1
"""Highest input derivative of an FMU that says no more than that it interpolates inputs: all that FMI 2.0 lets it say."""

ANNOTATION = "VendorAnnotations/Tool[@name='flexfmu']//InputDerivatives"
"""Where our FMUs say more: the attribute ``maxOrder`` is the highest order that fmi2SetRealInputDerivatives takes."""


@cache
def highest_input_derivative(fmu: UnpackedFmu) -> int:
    """Order of the highest input derivative that the FMU takes; 0 where it doesn't interpolate inputs.

    Raises:
        FmuFileError: the annotation is no order.
    """
    if not fmu.description.coSimulation.canInterpolateInputs:
        return 0
    stated = ElementTree.parse(fmu.folder / "modelDescription.xml").find(ANNOTATION)
    if stated is None:
        return INTERPOLATION_ORDER
    text = stated.get("maxOrder", "")
    if not text.isdecimal():
        raise FmuFileError(f"{fmu.path} is a broken FMU: its InputDerivatives have maxOrder = {text!r}; build it again")
    return int(text)


def highest_output_derivative(fmu: UnpackedFmu) -> int:
    """Order of the highest output derivative that the FMU gives."""
    return int(fmu.description.coSimulation.maxOutputDerivativeOrder or 0)


def needs_regular_steps(fmu: UnpackedFmu) -> bool:
    """Whether all communication steps of the FMU must have the same length."""
    return not fmu.description.coSimulation.canHandleVariableCommunicationStepSize


def only_once_per_process(fmu: UnpackedFmu) -> bool:
    """Whether a process can have one instance of the FMU only."""
    return bool(fmu.description.coSimulation.canBeInstantiatedOnlyOncePerProcess)


def needs(fmu: UnpackedFmu) -> str:
    """What an FMU that fails to start may lack, to be added to the reason; empty where it stands on its own."""
    if not fmu.description.coSimulation.needsExecutionTool:
        return ""
    tool = fmu.description.generationTool or "the tool that exported it"
    return f"; it needs {tool} on this machine, running or licensed (needsExecutionTool = true)"


def steps_asynchronously(fmu: UnpackedFmu) -> bool:
    """Whether fmi2DoStep may return before its step is done, with fmi2Pending."""
    return bool(fmu.description.coSimulation.canRunAsynchronuously)


def fixed_step(fmu: UnpackedFmu) -> float | None:
    """Step size [s] of an FMU that can't vary its communication step, of its default experiment or its own fixed internal one;
    None for any other.

    Raises:
        FmuFileError: the step size isn't positive.
    """
    experiment = fmu.description.defaultExperiment
    stated = (experiment.stepSize if experiment else None) or fmu.description.coSimulation.fixedInternalStepSize
    if not needs_regular_steps(fmu) or not stated:
        return None
    step = float(stated)
    if not 0.0 < step < inf:
        raise FmuFileError(f"{fmu.path} is a broken FMU: its step size is {step:g} s; it must be positive")
    return step
