"""Whether communication steps may be of any size, as claimed, and whether inputs are interpolated, as claimed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.fmu_build.checks.fmu import EXCITATION, FmuUnderTest, size_of
from flexfmu.fmu_build.finding import Finding, Severity

SPLIT = 3
"""Parts of a split step."""

SPLIT_TOLERANCE = 0.05
"""What splitting steps may change, relative to an output's largest value: far more than any solver's error.

It tells an FMU that advances by a step size of its own, whatever it is asked for: half of the moving outputs have to change
by more, since fast vibrations that are hardly there are solver errors for the most part.
"""

STAIRS = 16
"""Stairs that replace a ramp: parts of one step, or whole steps where outputs change at sample instants alone."""

MOST_INPUTS = 8
_SIGNIFICANT = 1e-9


def splits_steps(fmu: FmuUnderTest) -> Finding | None:
    """Three small steps take the FMU about as far as a large one."""
    if not fmu.has_variable_step or not fmu.outputs:
        return None
    with fmu.instance("whole") as whole, fmu.instance("split") as split:
        whole.initialize()
        split.initialize()
        rows = [(_step(whole, fmu, n, 1), _step(split, fmu, n, SPLIT)) for n in range(fmu.steps)]
    first, second = (np.array(side) for side in zip(*rows, strict=True))
    scale = np.maximum(np.abs(first).max(axis=0), 1e-12)
    apart = np.median(np.abs(first - second), axis=0) / scale
    moving = np.ptp(first, axis=0) > 0.0
    if not moving.any() or not np.median(apart[moving]) > SPLIT_TOLERANCE:
        return None
    worst = int(np.argmax(apart))
    return Finding(
        "variable step",
        f"{fmu.outputs[worst].name} changes by {apart[worst]:.0%} of its largest value where each step is split in "
        f"{SPLIT}",
        "advance by communicationStepSize, or don't claim canHandleVariableCommunicationStepSize",
        Severity.WARNING,
    )


def interpolates_inputs(fmu: FmuUnderTest) -> Finding | None:
    """A ramp given by its derivative does what the same ramp does in small stairs."""
    claims = fmu.has_variable_step and fmu.element.canInterpolateInputs
    if not claims or not fmu.outputs or (_is_sampled(fmu) and fmu.steps < STAIRS):
        return None
    for variable in fmu.inputs[:MOST_INPUTS]:
        exact, ramp, held = (_ramp(fmu, variable, how) for how in ("stairs", "derivative", "held"))
        missed, ignored = (float(np.abs(values - exact).max(initial=0.0)) for values in (ramp, held))
        if ignored > _SIGNIFICANT * float(np.abs(exact).max(initial=0.0)) and missed > 0.5 * ignored:
            return Finding(
                "input derivatives",
                f"with a derivative of {variable.name} the outputs are {missed:.3g} off, with a constant input {ignored:.3g}",
                "use fmi2SetRealInputDerivatives within the step, or don't claim canInterpolateInputs",
            )
    return None


def _is_sampled(fmu: FmuUnderTest) -> bool:
    """Whether all outputs are discrete."""
    return not fmu.smooth_outputs


def _step(instance: Any, fmu: FmuUnderTest, n: int, parts: int) -> NDArray[np.float64]:
    """Outputs after a step in so many parts."""
    instance.set(fmu.inputs, fmu.input_values(n))
    for part in range(parts):
        instance.step(n + part / parts, parts)
    return np.asarray(instance.get(fmu.outputs))


def _ramp(fmu: FmuUnderTest, variable: Any, how: str) -> NDArray[np.float64]:
    """Outputs after a step over which one input rises from its start, given in one way or another; at the end it has risen.

    A sampled FMU sees its inputs at its sample instants alone, so that a step has to contain some: it is as long as `STAIRS`
    of the steps that the FMU proposes. What it reads at the beginning of such a step is what the ramp has there; of
    continuous inputs, stairs of the mean have the same integral.
    """
    span, within = (STAIRS, 0.0) if _is_sampled(fmu) else (1, 0.5)
    rise = EXCITATION * size_of(variable)
    start = float(variable.start or 0.0)
    with fmu.instance(how) as instance:
        instance.initialize()
        parts = STAIRS if how == "stairs" else 1
        for part in range(parts):
            stair = start if how != "stairs" else start + rise * (part + within) / STAIRS
            instance.set([variable], np.array([stair]))
            if how == "derivative":
                instance.library.setRealInputDerivatives([variable.valueReference], [1], [rise / (span * fmu.step)])
            instance.library.doStep(fmu.start + part * span * fmu.step / parts, span * fmu.step / parts)
        instance.set([variable], np.array([start + rise]))
        return np.asarray(instance.get(fmu.smooth_outputs or fmu.outputs))
