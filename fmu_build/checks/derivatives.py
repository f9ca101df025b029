"""Derivatives that the FMU gives, against differences of what it computes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.fmu_build.checks.fmu import FmuUnderTest, Kind, size_of
from flexfmu.fmu_build.finding import Finding

Vector = NDArray[np.float64]

DIFFERENCE = 1e-5
"""Step of the difference quotients relative to a variable's size: rounding and truncation are about equal."""

DIRECTIONAL_TOLERANCE = 1e-4
"""What directional derivatives may be off, relative to the largest; difference quotients are good to 1e-6 or so."""

NEGLIGIBLE = 1e-5
"""Influence on an unknown, relative to its size, below which difference quotients are rounding errors."""

MOST_POINTS = 60
"""Communication points at which output derivatives are compared."""

PARTS = 64
"""Parts of a communication step between these points, so that fast vibrations are resolved."""

RESOLVED = 0.2
"""How much a slope may change from one step to the next where the step is short enough to judge derivatives by it."""

ROUNDING = 1e-7
"""Uncertainty of outputs relative to the largest."""

FAILING_SHARE = 0.25
"""Share of the points that have to fail: at events differences are wrong, not derivatives."""


def directional_derivatives_are_right(fmu: FmuUnderTest) -> Finding | None:
    """fmi2GetDirectionalDerivative against central differences, input by input and state by state."""
    if not fmu.element.providesDirectionalDerivative:
        return None
    with fmu.instance("directional") as instance:
        if fmu.kind is Kind.COSIMULATION:
            instance.enter_initialization()
        else:
            instance.initialize()
            instance.advance(0, 1)
        unknowns, knowns = _unknowns(fmu), [*fmu.inputs, *_states(fmu)]
        if not unknowns or not knowns:
            return None
        matrix = np.column_stack([instance.directional(unknowns, [known], np.ones(1)) for known in knowns])
        differences = np.column_stack([_difference(fmu, instance, unknowns, known) for known in knowns])
    return _compare(unknowns, knowns, matrix, differences)


def _unknowns(fmu: FmuUnderTest) -> list[Any]:
    """Outputs, and for model exchange the states' derivatives."""
    if fmu.kind is Kind.COSIMULATION:
        return fmu.smooth_outputs
    derivatives = [unknown.variable for unknown in fmu.description.derivatives or ()]
    return [*derivatives, *fmu.smooth_outputs]


def _states(fmu: FmuUnderTest) -> list[Any]:
    if fmu.kind is Kind.COSIMULATION:
        return []
    return [unknown.variable.derivative for unknown in fmu.description.derivatives or ()]


def _difference(fmu: FmuUnderTest, instance: Any, unknowns: Sequence[Any], known: Any) -> Vector:
    """Central difference quotient of all unknowns."""
    states = _states(fmu)
    value = instance.get([known])
    step = DIFFERENCE * max(size_of(known), abs(float(value[0])))
    ends = []
    for sign in (1.0, -1.0):
        _set(instance, states, known, value + sign * step)
        ends.append(np.asarray(instance.get(unknowns)))
    _set(instance, states, known, value)
    return np.asarray((ends[0] - ends[1]) / (2.0 * step))


def _set(instance: Any, states: Sequence[Any], known: Any, value: Vector) -> None:
    """Set an input, or a state, which goes with all the others."""
    if known not in states:
        instance.set([known], value)
        return
    x = instance.continuous_states()
    x[states.index(known)] = value[0]
    instance.set_continuous_states(x)


def _compare(unknowns: Sequence[Any], knowns: Sequence[Any], matrix: Vector, differences: Vector) -> Finding | None:
    """A finding about the worst entry, each measured by the largest of its row in units of the known's size."""
    sizes = np.array([size_of(known) for known in knowns])
    apart = np.abs(matrix - differences) * sizes
    floor = NEGLIGIBLE * np.array([[size_of(unknown)] for unknown in unknowns])
    scale = np.maximum((np.abs(differences) * sizes).max(axis=1, keepdims=True), floor)
    apart = np.where(np.isfinite(apart), apart / scale, np.inf)
    row, column = map(int, np.unravel_index(int(np.argmax(apart)), apart.shape))
    if apart[row, column] <= DIRECTIONAL_TOLERANCE:
        return None
    return Finding(
        "directional derivatives",
        f"d {unknowns[row].name} / d {knowns[column].name} is {matrix[row, column]:.6g}, differences give "
        f"{differences[row, column]:.6g}",
        "correct fmi2GetDirectionalDerivative, or don't claim providesDirectionalDerivative",
    )


def output_derivatives_are_right(fmu: FmuUnderTest) -> Finding | None:
    """Each order of an output's derivative against the slopes of the order below, before and after a point."""
    most = int(fmu.element.maxOutputDerivativeOrder or 0) if fmu.kind is Kind.COSIMULATION else 0
    points = MOST_POINTS if fmu.has_variable_step else min(fmu.steps, MOST_POINTS)
    if not most or not fmu.smooth_outputs or points < 3:
        return None
    parts = PARTS if fmu.has_variable_step else 1
    with fmu.instance("derivatives") as instance:
        instance.initialize()
        instance.set(fmu.inputs, fmu.input_values(0))
        jets = np.array(
            [_jet(fmu, instance, n / parts, parts, most) for n in range(points)]
        )  # points, orders from 0, outputs
    step = fmu.step / parts
    slopes = np.diff(jets[:, :-1], axis=0) / step
    before, after, given = slopes[:-1], slopes[1:], jets[1:-1, 1:]
    size = np.array([size_of(variable) for variable in fmu.smooth_outputs])
    noise = (ROUNDING * np.abs(jets[:, :-1]).max(axis=0) + 1e-12 * size) / step
    bend, off = np.abs(after - before), np.abs(given - 0.5 * (before + after))
    resolved = bend <= RESOLVED * np.maximum(np.abs(before), np.abs(after)) + noise
    failing = resolved & ~(off <= bend + 0.05 * np.abs(before) + noise)
    share = failing.sum(axis=0) / np.maximum(resolved.sum(axis=0), 1)
    order, output = map(int, np.unravel_index(int(np.argmax(share)), share.shape))
    if share[order, output] <= FAILING_SHARE:
        return None
    where = int(np.argmax(np.where(failing, off, -1.0)[:, order, output]))
    return Finding(
        "output derivatives",
        f"derivative {order + 1} of {fmu.smooth_outputs[output].name} is {given[where, order, output]:.4g} at "
        f"{fmu.start + (where + 2) * step:.6g} s, differences give {before[where, order, output]:.4g} before and "
        f"{after[where, order, output]:.4g} after",
        "correct fmi2GetRealOutputDerivatives, or claim a lower maxOutputDerivativeOrder",
    )


def _jet(fmu: FmuUnderTest, instance: Any, n: float, parts: int, most: int) -> Vector:
    """Outputs after step ``n`` and their derivatives, shape (orders + 1, outputs); inputs stay, so nothing jumps."""
    instance.step(n, parts)
    references = [variable.valueReference for variable in fmu.smooth_outputs]
    orders = ([order] * len(references) for order in range(1, most + 1))
    return np.array(
        [
            instance.get(fmu.smooth_outputs),
            *(instance.library.getRealOutputDerivatives(references, order) for order in orders),
        ]
    )
