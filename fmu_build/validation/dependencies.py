"""Checks of the declared dependencies: each known is changed up and down, and the unknowns are compared.

A change of an unknown proves a dependency; an asymmetric change proves that it is not linear. Independence can't be proved:
a dependency may be small at all tested points.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import compress
from typing import Any

import numpy as np

from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.fmu import FmuUnderTest, InterfaceType
from flexfmu.fmu_build.validation.instance import RealArray
from flexfmu.fmu_build.validation.variables import size_of

SHARE = 0.01
"""Change of a known, relative to its size."""

INFLUENCE = 1e-6
"""Smallest change of an unknown, relative to its size, that proves a dependency; above rounding and iteration errors."""

MOST_KNOWNS = 100

TICK = 3
"""The tick at which clocked inputs change."""

LARGE = (0.0, 10.0, -100.0, 1000.0)
"""Sizes of these changes relative to those of other checks."""

_LINEAR = {"constant", "fixed", "tunable", "discrete"}
"""Values of dependenciesKind for which the unknown is linear in the known."""


def declared_dependencies_hold(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that unknowns have no undeclared dependencies, and that dependencies declared linear are linear."""
    structure = fmu.description
    unknowns = [*(structure.outputs or ())]
    if fmu.kind is InterfaceType.EXCHANGE:
        unknowns += structure.derivatives or ()
    # knowns: in co-simulation also discrete inputs
    inputs, reported, done = fmu.real_inputs, set[str](), 0
    states = fmu.states if fmu.kind is InterfaceType.EXCHANGE else []
    with fmu.initialized("dependencies") as instance:
        # at several instants: a dependency may vanish at one of them
        for instant in (min(fmu.steps, 3), fmu.steps // 2, fmu.steps):
            instance.advance(done, instant)
            done = max(done, instant)
            if instance.finished:
                return
            yield from _violations(unknowns, inputs, instance, reported)
            yield from _violations(unknowns, states, instance, reported, states)
    # without model exchange states can be set in Initialization Mode alone, where they may determine parameters too
    if fmu.description.modelExchange is None and fmu.perturbable_states:
        reals = [variable for variable in fmu.description.modelVariables if variable.type == "Real"]
        fixed = [variable for variable in reals if variable.variability in ("fixed", "tunable")]
        with fmu.instance("state_dependencies") as instance:
            instance.enter_initialization()
            for state in fmu.perturbable_states:
                up, down, _ = answers(instance, fixed, state, SHARE)
                for finding in _violations(unknowns, [state] * np.array_equal(up, down), instance, reported):
                    yield replace(finding, severity=Severity.WARNING)


def initial_dependencies_hold(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check the dependencies of InitialUnknowns on parameters, inputs and exact start values, in Initialization Mode."""
    # all unknowns against all settable Reals
    unknowns = fmu.description.initialUnknowns or ()
    knowns = [variable for variable in fmu.settable("parameter", "input", "output", "local") if variable.type == "Real"]
    with fmu.instance("initial_dependencies") as instance:
        instance.enter_initialization()
        # the same findings, with messages for this mode
        for finding in _violations(unknowns, knowns, instance, set()):
            message, remedy = f"in Initialization Mode {finding.message}", "declare it in InitialUnknowns"
            yield Finding(message, remedy, Severity.WARNING, finding.subject, check="dependencies of variables")


def clocked_outputs_are_up_to_date(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that clocked outputs that depend on inputs by their declaration follow those of the same tick, not of the one before."""
    outputs = [
        unknown.variable
        for unknown in fmu.description.outputs
        if unknown.variable.clocks
        and unknown.variable.type == "Real"
        and {*fmu.inputs} & {*(unknown.dependencies or ())}
    ]
    if not outputs:
        return
    now, then = list[RealArray](), list[RealArray]()
    for size in LARGE:
        with fmu.initialized("ticks") as instance:
            instance.advance(0, TICK)
            instance.advance(TICK, TICK + 1, size, lambda: now.append(instance.get(outputs)))
            then.append(instance.get(outputs))
    for variable in compress(outputs, (np.ptp(now, axis=0) == 0.0) & (np.ptp(then, axis=0) > 0.0)):
        message = f"{variable.name} follows an input only at the tick after it, though its dependencies name it"
        yield Finding(message, "update it at the tick, or leave the input out", Severity.WARNING, variable.name)


def answers(
    instance: Any, unknowns: Sequence[Any], known: Any, share: float, states: Sequence[Any] = ()
) -> tuple[RealArray, RealArray, float]:
    """Unknowns where a known has a larger and a smaller value, and the change of the known; it gets its value back.

    Args:
        instance: the instance.
        unknowns: variables that are read.
        known: input, parameter or state that is changed.
        share: change relative to the known's size.
        states: variables of the continuous states, which FMI sets only all together.
    """

    def set_known(value: RealArray) -> None:
        if known not in states:
            instance.set([known], value)
            return
        x = instance.continuous_states()
        x[states.index(known)] = value[0]
        instance.set_continuous_states(x)

    value = instance.get([known])
    step = share * max(size_of(known), abs(float(value[0])))
    ends = []
    try:
        for sign in (1.0, -1.0):
            set_known(value + sign * step)
            ends.append(np.asarray(instance.get(unknowns)))
    finally:  # outside of its domain a model has no value
        set_known(value)
    return ends[0], ends[1], step


def slope(instance: Any, unknowns: Sequence[Any], known: Any, share: float, states: Sequence[Any]) -> RealArray:
    """Central differences of the unknowns by a known, shape (unknowns,); arguments as for `answers`."""
    up, down, step = answers(instance, unknowns, known, share, states)
    return (up - down) / (2.0 * step)


def _violations(
    unknowns: Sequence[Any], knowns: Sequence[Any], instance: Any, reported: set[str], states: Sequence[Any] = ()
) -> Iterator[Finding]:
    """Yield findings about unknowns that contradict their declared dependencies, except those in ``reported``."""
    declared = [unknown for unknown in unknowns if unknown.dependencies is not None and unknown.variable.type == "Real"]
    if not declared:
        return
    variables = [unknown.variable for unknown in declared]
    sizes = np.array([size_of(variable) for variable in variables])
    # change one known after the other
    for known in knowns[:MOST_KNOWNS]:
        try:
            base = instance.get(variables)
            up, down, _ = answers(instance, variables, known, SHARE, states)
            again = instance.get(variables)
        except Exception:  # fmpy raises several types; the FMU rejects the known or its value
            continue
        if not np.isfinite([base, up, down]).all():
            continue
        # change and nonlinearity of each unknown, relative to its size; at the first value of the known, it must repeat
        scale = np.maximum(np.abs(base), sizes)
        repeats = np.abs(again - base) <= 1e-9 * scale
        change, bend = (np.where(repeats, np.abs(by) / scale, 0.0) for by in (up - base, up + down - 2.0 * base))
        for n, unknown in enumerate(declared):
            name = unknown.variable.name
            if name in reported or unknown.variable is known or unknown.variable.valueReference == known.valueReference:
                continue
            # undeclared, or declared as linear but nonlinear
            listed = [dependency.valueReference for dependency in unknown.dependencies]
            message = remedy = ""
            if known.valueReference not in listed:
                if change[n] > INFLUENCE:
                    message = f"{name} changes with {known.name}, which its dependencies don't name"
                    remedy = "declare it in ModelStructure: loops are found by it"
            elif unknown.dependenciesKind:
                kind = unknown.dependenciesKind[listed.index(known.valueReference)]
                if kind in _LINEAR and bend[n] > INFLUENCE + 1e-4 * change[n]:
                    message = f"{name} is no linear function of {known.name}, which its dependenciesKind {kind} says"
                    remedy = "declare it as dependent"
            if message:
                reported.add(name)
                yield Finding(message, remedy, subject=name)
