"""All dynamic checks, in the order of execution."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from flexfmu.fmu_build.validation.dependencies import declared_dependencies_hold, initial_dependencies_hold
from flexfmu.fmu_build.validation.derivatives import (
    directional_derivatives_are_right,
    output_derivatives_are_right,
    states_follow_their_derivatives,
)
from flexfmu.fmu_build.validation.exchange import (
    derivatives_depend_on_state_alone,
    event_indicators_are_given,
    integrator_steps_change_nothing,
    interfaces_agree,
    states_are_the_variables,
)
from flexfmu.fmu_build.validation.finding import Finding
from flexfmu.fmu_build.validation.fmu import FmuUnderTest
from flexfmu.fmu_build.validation.lifecycle import (
    accepts_odd_uris,
    gives_memory_back,
    instantiates,
    outputs_are_finite,
    refuses_illegal_calls,
    refuses_wrong_guid,
)
from flexfmu.fmu_build.validation.replay import (
    brings_inputs_back,
    reads_leave_the_state_alone,
    repeats_after_reset,
    repeats_itself,
    replays_saved_states,
    replays_serialized_state,
    two_instances_are_independent,
)
from flexfmu.fmu_build.validation.steps import (
    halving_the_step_changes_little,
    interpolates_inputs,
    reports_the_time,
)
from flexfmu.fmu_build.validation.values import one_call_does_what_several_do, parameters_are_kept, starts_are_kept

Check = Callable[[FmuUnderTest], Iterator[Finding]]
"""A dynamic check: runs an FMU and yields findings; a failed FMI call may raise fmpy's exception."""

CHECKS: dict[str, Check] = {
    "instantiation": instantiates,
    "guid": refuses_wrong_guid,
    "simulation": outputs_are_finite,
    "repeatability": repeats_itself,
    "resource location": accepts_odd_uris,
    "memory": gives_memory_back,
    "start value": starts_are_kept,
    "parameters": parameters_are_kept,
    "several variables": one_call_does_what_several_do,
    "reset": repeats_after_reset,
    "reading": reads_leave_the_state_alone,
    "state": replays_saved_states,
    "inputs in the state": brings_inputs_back,
    "serialisation": replays_serialized_state,
    "instances": two_instances_are_independent,
    "rates": states_follow_their_derivatives,
    "variable step": halving_the_step_changes_little,
    "time": reports_the_time,
    "input derivatives": interpolates_inputs,
    "output derivatives": output_derivatives_are_right,
    "directional derivatives": directional_derivatives_are_right,
    "derivatives": derivatives_depend_on_state_alone,
    "states": states_are_the_variables,
    "integrator steps": integrator_steps_change_nothing,
    "event indicators": event_indicators_are_given,
    "dependencies of variables": declared_dependencies_hold,
    "initial dependencies": initial_dependencies_hold,
    "interfaces": interfaces_agree,
    "calls": refuses_illegal_calls,
}
"""Name of the finding → check. A check that doesn't apply to the FMU yields nothing; if the first fails, the others can't run."""

SEVERAL = {
    "repeatability",
    "resource location",
    "several variables",
    "reading",
    "state",
    "serialisation",
    "instances",
    "rates",
    "variable step",
    "time",
    "input derivatives",
    "output derivatives",
    "interfaces",
}
"""Checks that need several instances, skipped for an FMU that a process may instantiate only once."""
