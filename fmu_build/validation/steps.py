"""Whether communication steps may be of any size, as claimed, and whether inputs are interpolated, as claimed.

A solver's error shrinks when steps are halved and halved again; an error that stays belongs to the FMU (the idea of Richardson's
extrapolation). A ramp given by its derivative is compared with the same ramp in many small stairs.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException

from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.fmu import FmuUnderTest
from flexfmu.fmu_build.validation.instance import RealArray
from flexfmu.fmu_build.validation.library import MisbehaviourError
from flexfmu.fmu_build.validation.variables import moved, size_of, start_of

PARTS = (1, 2, 4)
"""Parts into which steps are split."""

SPLIT_POINTS = 60
SPLIT_TOLERANCE = 0.01
"""What the last halving of the step may change, relative to how far an output moves, if the first changed little more.

It reveals an FMU that advances by a step size of its own, or loses time at each step: that does not get less with the step.
"""

CONVERGING = 0.7
"""Largest ratio of the second halving's change to the first's where the influence of the step vanishes."""

STAIRS = 16
"""Steps that a ramp takes: communication steps, or samples of one step where outputs change at sample instants alone."""

FINE = 8
"""Stairs a communication step that replace a ramp."""

PERTURBATION = 0.02
"""Change of inputs and starts relative to their size: what sets the model in motion."""

RISES = (0.01, 0.1, 1.0)
"""Heights of a ramp relative to the input's size: the first that has an effect is enough."""

MOST_INPUTS = 8
TIMES = 5
"""Steps after which the time is read."""

_MOTION = 1e-4


def halving_the_step_changes_little(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Set in motion by a perturbation, two half steps take the FMU about as far as a whole one."""
    if not fmu.has_variable_step or not fmu.smooth_outputs:
        return
    # the same motion with whole, half and quarter steps
    runs = []
    for parts in PARTS:
        with fmu.instance("halved") as instance:
            instance.initialize(perturbed_states(fmu))
            instance.set(fmu.inputs, np.array([moved(variable, PERTURBATION) for variable in fmu.inputs]))
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
    # what halving changes for the second time has to be less than the first time
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


def perturbed_states(fmu: FmuUnderTest) -> dict[Any, float]:
    """Other starts of those states that may be set."""
    return {v: moved(v, PERTURBATION) for v in fmu.states if v in fmu.settable("output", "local")}


def reports_the_time(fmu: FmuUnderTest) -> Iterator[Finding]:
    """The independent variable isn't off by a fixed part of the step: that is no step size of the FMU's own."""
    times = [v for v in fmu.description.modelVariables if v.causality == "independent" and v.type == "Real"][:1]
    if not times or not fmu.has_variable_step or fmu.steps < TIMES:
        return
    shares = []
    for parts in (1, 3):
        with fmu.instance("time") as instance:
            instance.initialize()
            for n in range(TIMES):
                if not instance.step_from(fmu.start + n * fmu.step / parts, fmu.step / parts):
                    return
                time = fmu.start + (n + 1) * fmu.step / parts
                shares.append((float(instance.get(times)[0]) - time) * parts / fmu.step)
    off, spread = float(np.median(shares)), float(np.ptp(shares))
    # one that still shows the beginning of the step has not been asked to evaluate its outputs
    if spread < 1e-3 < 0.1 * abs(off) and abs(off + 1.0) > 1e-3:
        where = "ahead of" if off > 0.0 else "behind"
        message = f"{times[0].name} is {abs(off):.3g} communication steps {where} the communication point"
        yield Finding("time", message, "give the time of the communication point", Severity.WARNING, times[0].name)


def interpolates_inputs(fmu: FmuUnderTest) -> Iterator[Finding]:
    """A ramp given by its derivative does what the same ramp does in small stairs."""
    # only what is claimed, where outputs show a difference
    claims = fmu.has_variable_step and fmu.element.canInterpolateInputs
    outputs = fmu.smooth_outputs or [variable for variable in fmu.outputs if variable.type == "Real"]
    if not claims or not outputs or (not fmu.smooth_outputs and fmu.steps < STAIRS):
        return
    # the first input that is wrong is enough
    for variable in fmu.inputs[:MOST_INPUTS]:
        found = _wrong_ramp(fmu, variable, outputs)
        if found is not None:
            n, missed, ignored = found
            yield Finding(
                "input derivatives",
                f"with a derivative of {variable.name} {outputs[n].name} is {missed:.3g} off, with a constant input "
                f"{ignored:.3g}",
                "use fmi2SetRealInputDerivatives within the step, or don't claim canInterpolateInputs",
            )
            return


def _wrong_ramp(fmu: FmuUnderTest, variable: Any, outputs: list[Any]) -> tuple[int, float, float] | None:
    """The output that shows it, how far it is off with the derivative and with constant inputs; None if all is well.

    The ramp gets higher until it has an effect on an output; an FMU that can't go on with such an input isn't judged.
    """
    fine, coarse = (2 * FINE, FINE) if fmu.smooth_outputs else (STAIRS, STAIRS)
    for share in RISES:
        rise = moved(variable, share) - start_of(variable)
        try:
            exact, rough = (_ramp(fmu, variable, outputs, rise, "stairs", parts) for parts in (fine, coarse))
            split, constant = (_ramp(fmu, variable, outputs, rise, "constant", parts) for parts in (coarse, 1))
        except (FMICallException, MisbehaviourError):
            return None
        missed = np.abs(_ramp(fmu, variable, outputs, rise, "derivative", 1) - exact)
        ignored, unsure = np.abs(constant - exact), np.maximum(np.abs(rough - exact), np.abs(split - constant))
        # outputs that the number of stairs or of steps changes can't be judged by them
        clear = (unsure < 0.2 * ignored) & (ignored > fmu.accuracy * np.abs(exact).max(initial=0.0))
        failing = clear & (missed > 0.5 * ignored)
        if clear.any():
            if failing.sum() <= 0.5 * clear.sum():
                return None
            n = int(np.argmax(np.where(failing, ignored, 0.0)))
            return n, float(missed[n]), float(ignored[n])
    return None


def _ramp(fmu: FmuUnderTest, variable: Any, outputs: list[Any], rise: float, how: str, parts: int) -> RealArray:
    """Outputs after an input has risen from its start, given in one way or another.

    A continuous input rises over several communication steps, each of some stairs that have the ramp's mean; then comes a step
    with a constant input, so that direct feedthrough is the same in all ways. A sampled FMU sees its inputs at its sample
    instants alone, so that a step has to contain some: it is as long as `STAIRS` of the steps that the FMU proposes, and what
    is read at the beginning of a stair is what the ramp has there.
    """
    is_smooth = bool(fmu.smooth_outputs)
    steps, length = (min(STAIRS, fmu.steps), fmu.step) if is_smooth else (1, STAIRS * fmu.step)
    start, slope = start_of(variable), rise / (steps * length)
    with fmu.instance(how) as instance:
        instance.initialize()
        # the rise
        for n in range(steps):
            for part in range(parts):
                risen = {"stairs": n + (part + 0.5 * is_smooth) / parts, "constant": n, "derivative": n}[how]
                instance.set([variable], np.array([start + rise * risen / steps]))
                if how == "derivative":
                    instance.library.setRealInputDerivatives([variable.valueReference], [1], [slope])
                instance.step_from(fmu.start + (n + part / parts) * length, length / parts)
        # a step with the input at its end
        instance.set([variable], np.array([start + rise]))
        if is_smooth:
            if how == "derivative":
                instance.library.setRealInputDerivatives([variable.valueReference], [1], [0.0])
            instance.step(steps)
        return np.asarray(instance.get(outputs))
