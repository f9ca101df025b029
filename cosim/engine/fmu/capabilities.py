"""Capabilities of an FMU that concern derivatives, steps and instances, from its model description."""

from __future__ import annotations

from functools import cache
from math import inf

from flexfmu.cosim.engine.errors import FmuFileError
from flexfmu.cosim.engine.fmu.file import UnpackedFmu, parsed

INTERPOLATION_ORDER = 1
"""Highest input derivative of an FMU that states only canInterpolateInputs; FMI 2.0 has no attribute for the order."""

ANNOTATION = "VendorAnnotations/Tool[@name='flexfmu']//InputDerivatives"
"""Annotation of our own FMUs; its ``maxOrder`` is the highest order that fmi2SetRealInputDerivatives takes."""


@cache
def highest_input_derivative(fmu: UnpackedFmu) -> int:
    """Return the order of the highest input derivative that the FMU takes; 0 if it doesn't interpolate inputs.

    Raises:
        FmuFileError: ``maxOrder`` of the annotation isn't a whole number.
    """
    if not fmu.description.coSimulation.canInterpolateInputs:
        return 0
    stated = parsed(fmu.folder).find(ANNOTATION)
    if stated is None:
        return INTERPOLATION_ORDER
    text = stated.get("maxOrder", "")
    if not text.isdecimal():
        raise FmuFileError(f"{fmu.path} is a broken FMU: its InputDerivatives have maxOrder = {text!r}; build it again")
    return int(text)


def highest_output_derivative(fmu: UnpackedFmu) -> int:
    """Return the order of the highest output derivative that the FMU states; 0 for none."""
    return int(fmu.description.coSimulation.maxOutputDerivativeOrder or 0)


def needs_regular_steps(fmu: UnpackedFmu) -> bool:
    """Return whether all communication steps of the FMU must have the same length."""
    return not fmu.description.coSimulation.canHandleVariableCommunicationStepSize


def only_once_per_process(fmu: UnpackedFmu) -> bool:
    """Return whether the FMU can be instantiated only once per process."""
    return bool(fmu.description.coSimulation.canBeInstantiatedOnlyOncePerProcess)


def needs(fmu: UnpackedFmu) -> str:
    """Return a hint for the error of an FMU that needs an execution tool; empty for any other FMU."""
    if not fmu.description.coSimulation.needsExecutionTool:
        return ""
    tool = fmu.description.generationTool or "the tool that exported it"
    return f"; it needs {tool} on this machine, running or licensed (needsExecutionTool = true)"


def steps_asynchronously(fmu: UnpackedFmu) -> bool:
    """Return whether fmi2DoStep may return fmi2Pending before its step is complete."""
    return bool(fmu.description.coSimulation.canRunAsynchronuously)


def fixed_step(fmu: UnpackedFmu) -> float | None:
    """Return the step size [s] of an FMU that can't vary its communication step; None for any other FMU.

    It is the step size of the default experiment, or else the fixed internal step size; None if neither is stated.

    Raises:
        FmuFileError: the step size isn't positive and finite.
    """
    experiment = fmu.description.defaultExperiment
    stated = (experiment.stepSize if experiment else None) or fmu.description.coSimulation.fixedInternalStepSize
    if not needs_regular_steps(fmu) or not stated:
        return None
    step = float(stated)
    if not 0.0 < step < inf:
        raise FmuFileError(f"{fmu.path} is a broken FMU: its step size is {step:g} s; it must be positive")
    return step
