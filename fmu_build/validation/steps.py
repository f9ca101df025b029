"""Checks of two claims: communication steps of any size, and interpolation of inputs.

The error of a solver shrinks when steps are halved repeatedly; an error that remains is due to the FMU (the idea of
Richardson extrapolation). An input ramp, set by its derivative, is compared with the same ramp in many small stairs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from math import factorial
from typing import Any

import numpy as np
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from numpy.polynomial import Polynomial

from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.fmu import FmuUnderTest
from flexfmu.fmu_build.validation.instance import MisbehaviourError, RealArray
from flexfmu.fmu_build.validation.variables import moved, size_of, start_of

PARTS = (1, 2, 4)
"""Numbers of parts into which a communication step is divided."""

SPLIT_POINTS = 60
SPLIT_TOLERANCE = 0.01
"""Largest change of an output at the second halving of the step, relative to its motion, if the change does not shrink.

A larger change reveals an FMU that uses a step size of its own or loses time at each step.
"""

CONVERGING = 0.7
"""Largest ratio of the changes at the second and first halving for which the outputs converge."""

SMALL_PARTS = 32
"""Number of parts of a communication step in which each is small."""

LONGEST_SMALL_STEPS = 5.0
"""Longest wall time of all runs with small steps [s]."""

SHORT = 0.003
"""Share of a communication step that may be missing."""

ALIKE = 0.2
"""Largest relative difference of two shares that are the same, and part of a difference that they may leave unexplained."""

STAIRS = 16
"""Duration of a ramp in communication steps; for discrete outputs in samples within one communication step."""

FINE = 8
"""Stairs per communication step that approximate a ramp."""

PERTURBATION = 0.02
"""Change of inputs and start values that sets the model in motion, relative to their size."""

_STAIRS = -1

RISES = (0.01, 0.1, 1.0)
"""Heights of a ramp relative to the input's size; the first with an effect is evaluated."""

MOST_INPUTS = 8
TIMES = 5
"""Number of steps after which the time is read."""

LEAST_MOTION = 1e-4
"""Smallest motion of an output, relative to its size, that exceeds the errors of the solvers."""


def halving_the_step_changes_little(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check, after a perturbation, that the outputs converge when communication steps are halved repeatedly.

    They may converge to a motion that takes longer: what stays the same when steps are halved, and is gone with small ones, is the
    share of each step that is missing, if a stretched time axis explains it.
    """
    if not fmu.has_variable_step or not fmu.smooth_outputs:
        return
    # the same motion with whole, half and quarter steps
    runs = _runs(fmu, min(fmu.steps, SPLIT_POINTS), PARTS)
    length = min(map(len, runs))
    whole, half, quarter = (rows[:length] for rows in runs)
    if length < 3:
        return
    # the second halving must change less than the first one
    first, second = change(fmu, half, whole), change(fmu, quarter, half)
    failing = (second > SPLIT_TOLERANCE) & (second > CONVERGING * first)
    if failing.any():
        worst = int(np.argmax(np.where(failing, second, 0.0)))
        yield Finding(
            f"{fmu.smooth_outputs[worst].name} changes by {first[worst]:.1%} of its motion where steps are "
            f"halved, and by {second[worst]:.1%} where they are halved again",
            "advance by all of communicationStepSize, or don't claim canHandleVariableCommunicationStepSize",
            Severity.WARNING,
        )
    elif fmu.step_seconds * len(whole) * 3 * SMALL_PARTS < LONGEST_SMALL_STEPS:
        yield from _short_steps(fmu, whole, half)


def _short_steps(fmu: FmuUnderTest, whole: RealArray, half: RealArray) -> Iterator[Finding]:
    """Yield a finding if outputs with whole and half steps are those with small steps at an earlier time.

    Args:
        whole, half: smooth outputs at communication points, with whole and half steps, shape (points, outputs).
    """
    # two sizes of small steps, which agree
    small, exact = _runs(fmu, len(whole), (SMALL_PARTS, 2 * SMALL_PARTS))
    if not len(small) == len(exact) == len(whole):
        return
    # the time that is missing at each point, in proportion to the time that has passed, by least squares
    lag = -fmu.step * np.arange(1.0, len(whole) + 1)[:, None] * np.gradient(exact, fmu.step, axis=0)
    share, other = (((rows - exact) * lag).sum(axis=0) / (lag**2).sum(axis=0).clip(1e-300) for rows in (whole, half))
    errors = (whole - exact, whole - exact - share * lag, small - exact)
    apart, left, unsure = (np.linalg.norm(each, axis=0) for each in errors)
    wrong = (share > SHORT) & (np.abs(share - other) < ALIKE * share) & (change(fmu, half, exact) > SHORT)
    wrong &= (left < ALIKE * apart) & (unsure < ALIKE * apart)
    if wrong.any():
        n = int(np.argmax(np.where(wrong, share, 0.0)))
        late = f"{share[n]:.2%} of the time late with steps of {fmu.step:g} s"
        message = f"{fmu.smooth_outputs[n].name} is {late}, and not with steps of {fmu.step / SMALL_PARTS:.2g} s"
        yield Finding(message, "advance by all of communicationStepSize", Severity.WARNING)


def _runs(fmu: FmuUnderTest, steps: int, parts: Sequence[int]) -> list[RealArray]:
    """The smooth outputs after each communication step of a perturbed run, for each number of parts of a step."""
    runs = []
    for each in parts:
        with fmu.instance("parts") as instance:
            initialize_perturbed(instance)
            runs.append(instance.read_steps(fmu.smooth_outputs, steps, each))
    return runs


def initialize_perturbed(instance: Any) -> None:
    """Initialise with perturbed start values of the settable states, and set perturbed inputs."""
    fmu = instance.fmu
    instance.initialize({variable: moved(variable, PERTURBATION) for variable in fmu.perturbable_states})
    instance.set(fmu.inputs, np.array([moved(variable, PERTURBATION) for variable in fmu.inputs]))


def change(fmu: FmuUnderTest, first: RealArray, second: RealArray) -> RealArray:
    """Median difference of each smooth output relative to its motion, shape (outputs,); 0 where it hardly moves."""
    motion = np.maximum(np.ptp(first, axis=0), np.ptp(second, axis=0))
    size = np.array([size_of(variable) for variable in fmu.smooth_outputs])
    enough = motion > LEAST_MOTION * np.maximum(size, np.abs(first).max(axis=0))
    return np.where(enough, np.median(np.abs(first - second), axis=0) / np.where(enough, motion, 1.0), 0.0)


def reports_the_time(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that the independent variable shows the time of the communication point.

    Only a constant offset in communication steps is an error; an internal step of the FMU gives another pattern.
    """
    times = fmu.times
    if not times or not fmu.has_variable_step or fmu.steps < TIMES:
        return
    shares = []
    for parts in (1, 3):
        with fmu.initialized("time") as instance:
            for n in range(TIMES):
                if not instance.step_from(fmu.start + n * fmu.step / parts, fmu.step / parts):
                    return
                time = fmu.start + (n + 1) * fmu.step / parts
                shares.append((float(instance.get(times)[0]) - time) * parts / fmu.step)
    off, spread = float(np.median(shares)), float(np.ptp(shares))
    # a lag of one whole step is tolerated: the FMU has not evaluated its outputs since doStep
    if spread < 1e-3 < 0.1 * abs(off) and abs(off + 1.0) > 1e-3:
        where = "ahead of" if off > 0.0 else "behind"
        message = f"{times[0].name} is {abs(off):.3g} communication steps {where} the communication point"
        yield Finding(message, "give the time of the communication point", Severity.WARNING, times[0].name)


def reports_the_last_successful_time(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that fmi2LastSuccessfulTime, if the FMU gives it, is the time of the communication point, or that of the FMU's own step."""
    steps = min(TIMES, fmu.steps)
    with suppress(FMICallException), fmu.initialized("last_time") as instance:
        if not all(instance.step(n) for n in range(steps)):
            return
        given = float(instance.library.getRealStatus(fmi2.fmi2LastSuccessfulTime))
        time = fmu.start + steps * fmu.step
        if not min(abs(given - each) for each in (time, *instance.get(fmu.times))) < 0.1 * fmu.step:
            message = f"fmi2LastSuccessfulTime is {given:.9g} s after steps to {time:.9g} s"
            yield Finding(message, "give the end of the last communication step", Severity.WARNING)


def interpolates_inputs(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that an input ramp, set by its derivative, has the same effect as the ramp in small stairs; so has a parabola, if the FMU
    takes second derivatives."""
    # only where the FMU claims it and the outputs can show a difference
    claims = fmu.has_variable_step and fmu.element.canInterpolateInputs
    outputs = fmu.smooth_outputs or [variable for variable in fmu.outputs if variable.type == "Real"]
    if not claims or not outputs or (not fmu.smooth_outputs and fmu.steps < STAIRS):
        return
    # report the first wrong input only
    for variable in fmu.inputs[:MOST_INPUTS]:
        for order, without in ((1, "a constant input"), (2, "the first derivative alone")):
            found = _wrong_ramp(fmu, variable, outputs, order)
            if found is None:
                continue
            n, missed, ignored = found
            yield Finding(
                f"with derivative {order} of {variable.name} {outputs[n].name} is {missed:.3g} off, with {without} "
                f"{ignored:.3g}",
                "use fmi2SetRealInputDerivatives within the step, or don't claim canInterpolateInputs",
            )
            return


def _wrong_ramp(fmu: FmuUnderTest, variable: Any, outputs: list[Any], order: int) -> tuple[int, float, float] | None:
    """Index of a wrong output, its error with the derivative and its error without it; None if all are correct.

    The height of the ramp grows until an output reacts. If the FMU rejects such an input, the result is None.
    """
    fine, coarse = (2 * FINE, FINE) if fmu.smooth_outputs else (STAIRS, STAIRS)
    for share in RISES:
        rise = moved(variable, share) - start_of(variable)
        try:
            given = _ramp(fmu, variable, outputs, rise, order, order, 1)
            exact, rough = (_ramp(fmu, variable, outputs, rise, order, _STAIRS, parts) for parts in (fine, coarse))
            split, constant = (_ramp(fmu, variable, outputs, rise, order, order - 1, parts) for parts in (coarse, 1))
        except (FMICallException, MisbehaviourError):
            return None
        missed = np.abs(given - exact)
        ignored, unsure = np.abs(constant - exact), np.maximum(np.abs(rough - exact), np.abs(split - constant))
        # ignore outputs that depend on the number of stairs or steps
        clear = (unsure < 0.2 * ignored) & (ignored > fmu.accuracy * np.abs(exact).max(initial=0.0))
        failing = clear & (missed > 0.5 * ignored)
        if order > 1:  # its effect may be less than a solver's error: only that there is none is certain
            failing &= np.abs(given - constant) < 0.01 * ignored
        if clear.any():
            if failing.sum() <= 0.5 * clear.sum():
                return None
            n = int(np.argmax(np.where(failing, ignored, 0.0)))
            return n, float(missed[n]), float(ignored[n])
    return None


def _ramp(
    fmu: FmuUnderTest, variable: Any, outputs: list[Any], rise: float, order: int, given: int, parts: int
) -> RealArray:
    """Outputs, shape (outputs,), after an input from the start value along a ramp or a parabola.

    With continuous outputs the ramp takes several communication steps; each stair has the mean of the ramp. A final step
    with a constant input makes the direct feedthrough equal for all values of ``given``. A sampled FMU reads its inputs only
    at sample instants: there the ramp takes one communication step of `STAIRS` default steps, and each stair has the value
    of the ramp at its beginning.

    Args:
        fmu: the FMU.
        variable: the input.
        outputs: variables to read.
        rise: height of the ramp.
        order: 1 for a ramp, 2 for a parabola.
        given: number of derivatives that are given at each communication point; `_STAIRS`: the input goes up in stairs.
        parts: parts into which communication steps are divided.
    """
    is_smooth = bool(fmu.smooth_outputs)
    steps, length = (min(STAIRS, fmu.steps), fmu.step) if is_smooth else (1, STAIRS * fmu.step)
    curve, orders = Polynomial([0.0] * order + [rise]), list(range(1, given + 1))
    with fmu.initialized("ramp") as instance:

        def set_input(values: Sequence[float]) -> None:
            instance.set([variable], np.array([start_of(variable) + values[0]]))
            if orders:
                instance.library.setRealInputDerivatives([variable.valueReference] * given, orders, values[1:])

        # the ramp: its mean, or the polynomial with its value and derivatives at the communication point
        for n in range(steps):
            for part in range(parts):
                if given == _STAIRS:
                    set_input([curve((n + (part + 0.5 * is_smooth) / parts) / steps)])
                else:
                    taylor = Polynomial([curve.deriv(k)(n / steps) / factorial(k) for k in range(given + 1)])
                    at = part / parts / steps
                    set_input([float(taylor.deriv(k)(at)) / (steps * length) ** k for k in range(given + 1)])
                instance.step_from(fmu.start + (n + part / parts) * length, length / parts)
        # the final step with a constant input
        set_input([rise, *(0.0 for _ in orders)])
        if is_smooth:
            instance.step(steps)
        return np.asarray(instance.get(outputs))
