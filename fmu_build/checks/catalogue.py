"""All checks that run the FMU, in their order."""

from __future__ import annotations

from flexfmu.fmu_build.checks.derivatives import directional_derivatives_are_right, output_derivatives_are_right
from flexfmu.fmu_build.checks.exchange import derivatives_depend_on_state_alone, interfaces_agree
from flexfmu.fmu_build.checks.life import (
    Check,
    accepts_odd_uris,
    gives_memory_back,
    instantiates,
    outputs_are_finite,
    refuses_wrong_guid,
)
from flexfmu.fmu_build.checks.replay import (
    repeats_after_reset,
    replays_saved_states,
    replays_serialized_state,
    two_instances_are_independent,
)
from flexfmu.fmu_build.checks.steps import interpolates_inputs, splits_steps

CHECKS: dict[str, Check] = {
    "instantiation": instantiates,
    "guid": refuses_wrong_guid,
    "resource location": accepts_odd_uris,
    "simulation": outputs_are_finite,
    "memory": gives_memory_back,
    "reset": repeats_after_reset,
    "state": replays_saved_states,
    "serialisation": replays_serialized_state,
    "instances": two_instances_are_independent,
    "variable step": splits_steps,
    "input derivatives": interpolates_inputs,
    "output derivatives": output_derivatives_are_right,
    "directional derivatives": directional_derivatives_are_right,
    "derivatives": derivatives_depend_on_state_alone,
    "interfaces": interfaces_agree,
}
"""Name of the finding → check; one that the FMU cannot take part in finds nothing. Without the first, none makes sense."""
