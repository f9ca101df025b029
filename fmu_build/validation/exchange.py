"""Checks of model exchange, and of its agreement with co-simulation in the same FMU.

Model exchange, integrated by CVODE with a tight tolerance, is the reference for co-simulation. Differences that shrink with
the communication step or the tolerance are due to the solvers and give no finding.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import redirect_stdout, suppress
from dataclasses import replace
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException

from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.fmu import FmuUnderTest, InterfaceType
from flexfmu.fmu_build.validation.instance import RealArray
from flexfmu.fmu_build.validation.steps import change
from flexfmu.fmu_build.validation.variables import moved, size_of, start_of

AGREEMENT = 0.01
"""Largest allowed difference of co-simulation and model exchange, relative to an output's motion."""

WRONG = 0.05
"""Difference, relative to an output's motion, above which the finding is an error unless smaller steps reduce it."""

POOR = 0.03
"""Largest allowed difference, relative to an output's motion, if smaller steps reduce it."""

INTEGRATION_TOLERANCE = 1e-8
POINTS = 100
"""Most communication steps over which the two interfaces are compared."""

LONGEST = 5.0
"""Time limit of one integration [s]."""

PERTURBATION = 0.05
"""Change of start values and inputs that sets the model in motion, relative to their size."""

EULER = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
"""Possible numbers of Euler steps per communication step."""

EXPLAINED = 0.2
"""Largest share of the difference that remains if the FMU uses Euler's method."""

STAYS = 0.7
"""Share of the difference that must remain with smaller communication steps to rule out the solver."""

STEPS = 6
"""Number of steps after which states and event indicators are checked."""

_TINY = 1e-9
_ROUNDING = 1e-11
_WANDER = 1e-4


def derivatives_depend_on_state_alone(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that the state derivatives at the same states are equal, but for rounding, after an evaluation at other states.

    Where forces balance, derivatives are differences of large terms: their rounding is judged by what they are elsewhere. What an
    inner iteration within the solver's accuracy leaves is a warning.
    """
    with fmu.initialized("pure") as instance:
        if not instance.states or instance.finished:
            return
        # evaluate at x, elsewhere, and at x again
        x = instance.continuous_states()
        first = instance.derivatives()
        instance.set_continuous_states(x * (1.0 + 1e-3) + 1e-6)
        scale = np.maximum(np.abs(first), np.abs(instance.derivatives()))
        instance.set_continuous_states(x)
        apart = np.nan_to_num(np.abs(first - instance.derivatives()))
    if (apart > _ROUNDING * scale).any():
        yield Finding(
            f"the states' derivatives differ by {apart.max():.3g} after a look at other states",
            "they must depend on time, states and inputs alone",
            Severity.ERROR if (apart > fmu.accuracy * scale).any() else Severity.WARNING,
        )


def states_are_the_variables(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that states, state derivatives and nominal values follow the order of ModelStructure/Derivatives."""
    if not fmu.states:
        return
    rates = [unknown.variable for unknown in fmu.description.derivatives]
    with fmu.initialized("states") as instance:
        if instance.finished:
            return
        # different values for all states reveal swapped ones
        x = instance.continuous_states()
        perturbed = x + PERTURBATION * np.array([size_of(variable) for variable in fmu.states]) * (
            1.0 + 0.1 * np.arange(x.size)
        )
        instance.set_continuous_states(perturbed)
        # values that two FMI functions must return alike
        getter = "fmi2GetContinuousStates"
        pairs = (
            (getter, "what fmi2SetContinuousStates has set", instance.continuous_states(), perturbed),
            (getter, "fmi2GetReal of the state", instance.continuous_states(), instance.get(fmu.states)),
            ("fmi2GetDerivatives", "fmi2GetReal of the derivative", instance.derivatives(), instance.get(rates)),
        )
        nominals = instance.nominals()
    # report the first difference only
    for function, other, values, expected in pairs:
        apart = np.abs(values - expected) > _TINY * np.maximum(np.abs(values), np.abs(expected))
        if apart.any():
            n = int(np.argmax(apart))
            message = f"{function} gives {values[n]:.9g} for {fmu.states[n].name}, {other} {expected[n]:.9g}"
            yield Finding(message, "keep to the order of ModelStructure/Derivatives")
            return
    if not (nominals > 0.0).all():
        n = int(np.argmin(nominals > 0.0))
        message = f"fmi2GetNominalsOfContinuousStates gives {nominals[n]:g} for {fmu.states[n].name}"
        yield Finding(message, "a nominal is above 0")


def integrator_steps_change_nothing(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that fmi2CompletedIntegratorStep does not change the states without requesting an event."""
    if not fmu.states:
        return
    with fmu.initialized("integrator_step") as instance:
        for n in range(1, STEPS + 1):
            if instance.finished or fmu.start + n * fmu.step >= instance.next_event:
                return
            # an integrator step
            instance.library.setTime(fmu.start + n * fmu.step)
            x = instance.continuous_states()
            x += _WANDER * np.maximum(np.abs(x), 1e-3)
            instance.set_continuous_states(x)
            instance.derivatives()
            # complete it; the FMU may request an event
            x = instance.continuous_states()
            event, instance.finished = instance.library.completedIntegratorStep()
            if event or instance.finished:
                return
            apart = np.abs(instance.continuous_states() - x)
            if (apart > _TINY * np.maximum(np.abs(x), 1e-6)).any():
                k = int(np.argmax(apart))
                message = f"fmi2CompletedIntegratorStep changes {fmu.states[k].name} by {apart[k]:.3g} without an event"
                yield Finding(message, "set enterEventMode, and change states in Event Mode")
                return


def time_events_lie_ahead(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that after each event the next time event is not in the past, where time goes from event to event."""
    with fmu.initialized("time_events") as instance:
        time = fmu.start
        for _ in range(STEPS):
            if instance.finished or not time <= instance.next_event <= fmu.stop:
                break
            time = instance.next_event
            instance.library.setTime(time)
            instance.library.completedIntegratorStep()
            instance.library.enterEventMode()
            instance.handle_events()
        if instance.next_event < time - _TINY * max(abs(time), fmu.step):
            message = f"fmi2NewDiscreteStates gives {instance.next_event:.9g} s as the next event at {time:.9g} s"
            yield Finding(message, "give an instant that lies ahead, or set nextEventTimeDefined to fmi2False")


def event_indicators_are_given(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check number, finiteness and repeatability of the event indicators, also after events, and that one of them changes."""
    count = int(fmu.description.numberOfEventIndicators or 0)
    if not count:
        return
    seen: list[RealArray] = []
    with fmu.initialized("event_indicators") as instance:
        for n in range(STEPS):
            if instance.finished:
                return
            try:
                # twice at the same point
                z, again = instance.event_indicators(), instance.event_indicators()
            except FMICallException as error:
                message = (
                    f"fmi2GetEventIndicators of {count}, which is numberOfEventIndicators, gives status {error.status}"
                )
                yield Finding(message, "give them all, or correct numberOfEventIndicators")
                return
            # finite and equal
            alike = np.isfinite(z) & np.isclose(z, again, rtol=1e-3, atol=1e-6)
            if not alike.all():
                k = int(np.argmin(alike))
                message = f"event indicator {k + 1} is {z[k]:.6g}, at a second call {again[k]:.6g}"
                yield Finding(message, "they must depend on time, states and inputs alone")
                return
            seen.append(z)
            if n % 2:  # an event triggered by the importing tool
                instance.library.enterEventMode()
                instance.handle_events()
            else:
                instance.advance(n, n + 1)
        # large changes of states and inputs, as far as the FMU takes them
        with suppress(FMICallException):
            for share in (0.01, -0.1, 1.0):
                if instance.states:
                    x = instance.continuous_states()
                    instance.set_continuous_states(x + share * np.maximum(np.abs(x), instance.nominals()))
                instance.set(fmu.inputs, np.array([moved(variable, share) for variable in fmu.inputs]))
                seen.append(instance.event_indicators())
    if np.ptp(seen, axis=0).max() == 0.0:
        message = "no event indicator changes with time, states or inputs"
        yield Finding(message, "give functions that pass through zero at events", Severity.WARNING)


def interfaces_agree(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that co-simulation agrees with model exchange under CVODE, after perturbing start values and inputs.

    A difference that Euler's method explains is the FMU's choice of solver and gives no finding.
    """
    if fmu.description.coSimulation is None or not fmu.smooth_outputs:
        return
    # an event that lies behind, a finding by itself, keeps an integrator where it is
    if any(time_events_lie_ahead(fmu)):
        return
    # communication steps whole, and in parts if co-simulation allows it
    sizes = (1, 4) if fmu.description.coSimulation.canHandleVariableCommunicationStepSize else (1,)
    for starts in _perturbations(fmu):
        # the same motion by CVODE, and by communication steps of one or two sizes
        try:
            exchange = _integrated(fmu, starts)
            slaves = [_stepped(fmu, starts, parts) for parts in sizes]
        except Exception:  # fmpy or CVODE can't run the model with these values
            continue
        rows = min(map(len, (exchange, *slaves)))
        if rows < 3:
            continue
        # differences with whole and with smaller communication steps
        exchange, whole, split = (each[:rows] for each in (exchange, slaves[0], slaves[-1]))
        apart, finer = change(fmu, exchange, whole), change(fmu, exchange, split)
        # a difference that shrinks with the step is due to the solver; accept it up to POOR
        apart = np.where((finer > AGREEMENT) & (finer > STAYS * apart) | (apart > POOR), apart, 0.0)
        if apart.max() > AGREEMENT:  # ignore what a tighter tolerance of CVODE changes
            tighter = _integrated(fmu, starts, 0.01 * INTEGRATION_TOLERANCE)
            unsure = change(fmu, exchange, tighter[:rows]) if len(tighter) >= rows else apart
            apart = np.where(apart > 3.0 * unsure, apart, 0.0)
        # report the largest difference unless Euler's method explains it
        worst = int(np.argmax(apart))
        if apart[worst] > AGREEMENT and not _is_euler(fmu, starts, whole, exchange):
            yield Finding(
                f"{fmu.smooth_outputs[worst].name} differs by {apart[worst]:.1%} of its motion between model exchange, "
                f"integrated by CVODE, and co-simulation",
                "both have to solve the same equations over the whole step",
                Severity.ERROR if apart[worst] > WRONG and finer[worst] > STAYS * apart[worst] else Severity.WARNING,
            )
            return


def _perturbations(fmu: FmuUnderTest) -> Iterator[dict[Any, float]]:
    """Yield start values of states and inputs, by variable: perturbed states, then perturbed inputs, then neither."""
    still = {variable: start_of(variable) for variable in fmu.inputs}
    if states := fmu.perturbable_states:
        yield still | {variable: moved(variable, PERTURBATION) for variable in states}
    if fmu.inputs:
        yield {variable: moved(variable, PERTURBATION) for variable in fmu.inputs}
    yield still


def _integrated(fmu: FmuUnderTest, starts: dict[Any, float], tolerance: float = INTEGRATION_TOLERANCE) -> RealArray:
    """Outputs of model exchange after each step, by fmpy's CVODE with constant inputs, shape (steps, outputs)."""
    steps = min(fmu.steps, POINTS)
    stop = fmu.start + steps * fmu.step
    signals = np.zeros(2, dtype=[("time", "f8"), *((variable.name, "f8") for variable in fmu.inputs)])
    signals["time"] = (fmu.start, stop)
    for variable in fmu.inputs:
        signals[variable.name] = starts[variable]
    with redirect_stdout(None):  # fmpy prints the names of inputs without values
        result = fmpy.simulate_fmu(
            str(fmu.folder),
            fmi_type="ModelExchange",
            validate=False,
            model_description=None if fmu.is_fmi3 else fmu.description,
            start_time=fmu.start,
            stop_time=stop,
            output_interval=fmu.step,
            solver="CVode",
            relative_tolerance=tolerance,
            record_events=False,
            start_values={variable.name: value for variable, value in starts.items() if variable not in fmu.inputs},
            input=signals if fmu.inputs else None,
            output=[variable.name for variable in fmu.smooth_outputs],
            timeout=LONGEST,
        )
    return np.column_stack([result[variable.name] for variable in fmu.smooth_outputs])[1:]


def _stepped(fmu: FmuUnderTest, starts: dict[Any, float], parts: int) -> RealArray:
    """Outputs of co-simulation after each step with constant inputs, shape (steps, outputs)."""
    slave = replace(fmu, kind=InterfaceType.COSIMULATION)
    with slave.instance("stepped") as instance:
        instance.initialize(starts)
        return np.asarray(instance.read_steps(fmu.smooth_outputs, min(fmu.steps, POINTS), parts))


def _is_euler(fmu: FmuUnderTest, starts: dict[Any, float], slave: RealArray, exact: RealArray) -> bool:
    """Whether Euler's method with one of the tried steps reproduces co-simulation."""
    steps = [fmu.step / parts for parts in EULER]
    steps += [step for step in (1e-2, 1e-3, 1e-4) if fmu.step / 100 <= step < fmu.step]
    for step in steps:
        # Euler's method with this step
        parts = round(fmu.step / step)
        rows = []
        with suppress(FMICallException), fmu.instance("euler") as instance:
            instance.initialize(starts)
            for n in range(len(slave) * parts):
                instance.set_continuous_states(instance.continuous_states() + step * instance.derivatives())
                instance.library.setTime(fmu.start + (n + 1) * step)
                if (n + 1) % parts == 0:
                    rows.append(instance.get(fmu.smooth_outputs))
        if len(rows) < len(slave):
            continue
        # is Euler's method much nearer to co-simulation than the exact solution?
        euler, truth = (change(fmu, np.array(each), slave).max() for each in (rows, exact))
        if euler < EXPLAINED * truth:
            return True
    return False
