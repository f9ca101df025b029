"""Whether communication steps may be of any size, as claimed, and whether inputs are interpolated, as claimed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.fmu_build.checks.fmu import FmuUnderTest, moved, size_of, start_of
from flexfmu.fmu_build.finding import Finding, Severity

Rows = NDArray[np.float64]

PARTS = (1, 2, 4)
"""Parts into which steps are split."""

SPLIT_POINTS = 60
SPLIT_TOLERANCE = 0.01
"""What the last halving of the step may change, relative to how far an output moves, if the first changed little more.

It tells an FMU that advances by a step size of its own, or loses time at each step: that does not get less with the step.
"""

CONVERGING = 0.7
"""What the second halving may be of the first where the step size matters less and less."""

STAIRS = 16
"""Stairs that replace a ramp: parts of one step, or whole steps where outputs change at sample instants alone."""

KICK = 0.02
"""Change of inputs and starts relative to their size: what sets the model in motion."""

RISE = 0.01
"""Height of a ramp relative to the input's size."""

MOST_INPUTS = 8
_MOTION = 1e-4


def halving_the_step_changes_little(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Set in motion by a kick, two half steps take the FMU about as far as a whole one."""
    if not fmu.has_variable_step or not fmu.smooth_outputs:
        return
    runs = []
    for parts in PARTS:
        with fmu.instance("halved") as instance:
            instance.initialize(kicked_states(fmu))
            instance.set(fmu.inputs, np.array([moved(variable, KICK) for variable in fmu.inputs]))
            rows = []
            for n in range(min(fmu.steps, SPLIT_POINTS)):
                if not all(instance.step(n + part / parts, parts) for part in range(parts)):
                    break
                rows.append(instance.get(fmu.smooth_outputs))
        runs.append(np.array(rows).reshape(len(rows), -1))
    length = min(map(len, runs))
    whole, half, quarter = (rows[:length] for rows in runs)
    if length < 3:
        return
    size = np.array([size_of(variable) for variable in fmu.smooth_outputs])
    motion = np.ptp(quarter, axis=0)
    first, second = (np.median(np.abs(a - b), axis=0) for a, b in ((whole, half), (half, quarter)))
    moves = motion > _MOTION * np.maximum(size, np.abs(quarter).max(axis=0))
    failing = moves & (second > SPLIT_TOLERANCE * motion) & (second > CONVERGING * first)
    if failing.any():
        worst = int(np.argmax(np.where(failing, second / np.maximum(motion, 1e-300), 0.0)))
        yield Finding(
            "variable step",
            f"{fmu.smooth_outputs[worst].name} changes by {first[worst] / motion[worst]:.1%} of its motion where steps are "
            f"halved, and by {second[worst] / motion[worst]:.1%} where they are halved again",
            "advance by all of communicationStepSize, or don't claim canHandleVariableCommunicationStepSize",
            Severity.WARNING,
        )


def kicked_states(fmu: FmuUnderTest) -> dict[Any, float]:
    """Other starts of those states that may be set."""
    return {v: moved(v, KICK) for v in fmu.states if v in fmu.settable("output", "local")}


def interpolates_inputs(fmu: FmuUnderTest) -> Iterator[Finding]:
    """A ramp given by its derivative does what the same ramp does in small stairs."""
    claims = fmu.has_variable_step and fmu.element.canInterpolateInputs
    outputs = fmu.smooth_outputs or [variable for variable in fmu.outputs if variable.type == "Real"]
    if not claims or not outputs or (not fmu.smooth_outputs and fmu.steps < STAIRS):
        return
    parts = STAIRS * (1 + bool(fmu.smooth_outputs))
    for variable in fmu.inputs[:MOST_INPUTS]:
        fine, exact = (_ramp(fmu, variable, outputs, "stairs", stairs) for stairs in (parts, STAIRS))
        split, held = (_ramp(fmu, variable, outputs, "held", stairs) for stairs in (parts, 1))
        missed = np.abs(_ramp(fmu, variable, outputs, "derivative", 1) - fine)
        ignored, unsure = np.abs(held - fine), np.maximum(np.abs(exact - fine), np.abs(split - held))
        # outputs that the number of stairs or of steps changes can't be judged by them
        clear = (unsure < 0.2 * ignored) & (ignored > fmu.accuracy * np.abs(fine).max(initial=0.0))
        failing = clear & (missed > 0.5 * ignored)
        if clear.any() and failing.sum() > 0.5 * clear.sum():
            n = int(np.argmax(np.where(failing, ignored, 0.0)))
            yield Finding(
                "input derivatives",
                f"with a derivative of {variable.name} {outputs[n].name} is {missed[n]:.3g} off, with a constant input "
                f"{ignored[n]:.3g}",
                "use fmi2SetRealInputDerivatives within the step, or don't claim canInterpolateInputs",
            )
            return


def _ramp(fmu: FmuUnderTest, variable: Any, outputs: list[Any], how: str, parts: int) -> Rows:
    """Outputs after a step over which one input rises from its start, given in one way or another; at the end it has risen.

    A sampled FMU sees its inputs at its sample instants alone, so that a step has to contain some: it is as long as `STAIRS`
    of the steps that the FMU proposes. What it reads at the beginning of such a step is what the ramp has there; of
    continuous inputs, stairs of the mean have the same integral.
    """
    span, within = (1, 0.5) if fmu.smooth_outputs else (STAIRS, 0.0)
    start = start_of(variable)
    rise = moved(variable, RISE) - start
    with fmu.instance(how) as instance:
        instance.initialize()
        for part in range(parts):
            stair = start if how != "stairs" else start + rise * (part + within) / parts
            instance.set([variable], np.array([stair]))
            if how == "derivative":
                instance.library.setRealInputDerivatives([variable.valueReference], [1], [rise / (span * fmu.step)])
            instance.library.doStep(fmu.start + part * span * fmu.step / parts, span * fmu.step / parts)
        instance.set([variable], np.array([start + rise]))
        return np.asarray(instance.get(outputs))
