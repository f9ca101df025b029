"""Dependencies that the model structure declares, against what changes when an input or a state is moved up and down.

A change shows a dependency, a difference between the two directions a dependency that is not linear. Independence is never
proved: a dependency may be small at all points that are tried.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.fmu import FmuUnderTest, InterfaceType
from flexfmu.fmu_build.validation.instance import RealArray
from flexfmu.fmu_build.validation.variables import size_of

SHARE = 0.01
"""How far knowns are moved, relative to their size."""

INFLUENCE = 1e-6
"""Least change of an unknown, relative to its size, that neither rounding nor an inner iteration's tolerance
explains."""

MOST_KNOWNS = 100

_LINEAR = {"constant", "fixed", "tunable", "discrete"}
"""Kinds of dependencies that are a factor."""


def declared_dependencies_hold(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Unknowns depend on nothing that they don't declare, and factors that are declared constant are constant."""
    structure = fmu.description
    unknowns = [*(structure.outputs or ())]
    if fmu.kind is InterfaceType.EXCHANGE:
        unknowns += structure.derivatives or ()
    # what may be moved: in co-simulation discrete inputs too
    inputs, reported, done = fmu.inputs, set[str](), 0
    if fmu.kind is InterfaceType.COSIMULATION:  # in model exchange discrete ones are set at events alone
        inputs = [v for v in fmu.description.modelVariables if v.causality == "input" and v.type == "Real"]
    with fmu.instance("dependencies") as instance:

        def set_input(known: Any, value: RealArray) -> None:
            instance.set([known], value)

        def set_state(known: Any, value: RealArray) -> None:
            x = instance.continuous_states()
            x[fmu.states.index(known)] = value[0]
            instance.set_continuous_states(x)

        instance.initialize()
        # at several points of the run: a dependency may vanish at one of them
        for instant in (min(fmu.steps, 3), fmu.steps // 2, fmu.steps):
            instance.advance(done, instant)
            done = max(done, instant)
            if instance.finished:
                return
            yield from _violations(unknowns, inputs, instance, set_input, reported)
            if fmu.kind is InterfaceType.EXCHANGE:
                yield from _violations(unknowns, fmu.states, instance, set_state, reported)


def initial_dependencies_hold(fmu: FmuUnderTest) -> Iterator[Finding]:
    """The same in Initialization Mode, for parameters, inputs and exact starts."""
    # all unknowns against all Real variables that may be set before the start
    unknowns = fmu.description.initialUnknowns or ()
    knowns = [variable for variable in fmu.settable("parameter", "input", "output", "local") if variable.type == "Real"]
    with fmu.instance("initial_dependencies") as instance:
        instance.enter_initialization()

        def set_known(known: Any, value: RealArray) -> None:
            instance.set([known], value)

        # the same findings, with words of this mode
        for finding in _violations(unknowns, knowns, instance, set_known, set()):
            yield Finding(
                finding.check,
                f"in Initialization Mode {finding.message}",
                "declare it in InitialUnknowns",
                Severity.WARNING,
                finding.subject,
            )


def _violations(
    unknowns: Sequence[Any],
    knowns: Sequence[Any],
    instance: Any,
    set_known: Callable[[Any, RealArray], None],
    reported: set[str],
) -> Iterator[Finding]:
    """Findings about unknowns that change with a known other than declared, but for those in ``reported``."""
    declared = [unknown for unknown in unknowns if unknown.dependencies is not None and unknown.variable.type == "Real"]
    if not declared:
        return
    variables = [unknown.variable for unknown in declared]
    sizes = np.array([size_of(variable) for variable in variables])
    # one known after the other is moved up and down
    for known in knowns[:MOST_KNOWNS]:
        answers = _answers(variables, known, instance, set_known)
        if answers is None:
            continue
        base, up, down, steps = answers
        # change and curvature of every unknown, relative to its size
        scale = np.maximum(np.abs(base), sizes)
        change = np.abs(up - base) / scale
        bend = (
            np.abs((up - base) * steps[1] - (down - base) * steps[0]) / np.maximum(np.abs(steps).max(), 1e-300) / scale
        )
        for n, unknown in enumerate(declared):
            name = unknown.variable.name
            if name in reported or unknown.variable is known or unknown.variable.valueReference == known.valueReference:
                continue
            for finding in _contradiction(unknown, known, change[n], bend[n]):
                reported.add(name)
                yield finding


def _contradiction(unknown: Any, known: Any, change: float, bend: float) -> Iterator[Finding]:
    """A finding if an unknown changes or bends with a known in a way that its declaration excludes."""
    name = unknown.variable.name
    listed = [dependency.valueReference for dependency in unknown.dependencies]
    # it changes although it isn't declared to depend on the known
    if known.valueReference not in listed:
        if change > INFLUENCE:
            message = f"{name} changes with {known.name}, which its dependencies don't name"
            remedy = "declare it in ModelStructure: loops are found by it"
            yield Finding("dependencies of variables", message, remedy, subject=name)
        return
    # it is declared as linear but is not
    kind = unknown.dependenciesKind[listed.index(known.valueReference)] if unknown.dependenciesKind else ""
    if kind in _LINEAR and bend > INFLUENCE + 1e-4 * change:
        message = f"{name} is no linear function of {known.name}, which its dependenciesKind {kind} says"
        yield Finding("dependencies of variables", message, "declare it as dependent", subject=name)


def _answers(
    variables: Sequence[Any], known: Any, instance: Any, set_known: Callable[[Any, RealArray], None]
) -> tuple[RealArray, RealArray, RealArray, RealArray] | None:
    """Unknowns as they are and with the known moved up and down, and the two steps; None where the FMU refuses the values."""
    try:
        value = instance.get([known])
        step = SHARE * max(size_of(known), abs(float(value[0])))
        base = instance.get(variables)
        ends, steps = [], []
        for sign in (1.0, -1.0):
            set_known(known, value + sign * step)
            ends.append(instance.get(variables))
            steps.append(sign * step)
        # back at the start the FMU has to give the first values again
        set_known(known, value)
        again = instance.get(variables)
    except Exception:  # fmpy's own kinds of errors: the known can't be set here, or not to this
        return None
    if not np.allclose(base, again, rtol=1e-9, atol=0.0) or not np.isfinite([base, *ends]).all():
        return None
    return base, ends[0], ends[1], np.array(steps)
