"""What holds for model exchange alone, and between the two interfaces of one FMU."""

from __future__ import annotations

from typing import Any

import fmpy
import numpy as np

from flexfmu.fmu_build.checks.fmu import FmuUnderTest, Kind, size_of
from flexfmu.fmu_build.finding import Finding, Severity

AGREEMENT = 0.01
"""What co-simulation and model exchange may differ, relative to an output's largest value: any solver does better."""

INTEGRATION_TOLERANCE = 1e-6
POINTS = 100
"""Communication steps over which the two interfaces are compared."""


def derivatives_depend_on_state_alone(fmu: FmuUnderTest) -> Finding | None:
    """The right-hand side is a function: back at the same states it has the same value, to the last bit."""
    if fmu.kind is not Kind.EXCHANGE:
        return None
    with fmu.instance("pure") as instance:
        instance.initialize()
        if not instance.states:
            return None
        x = instance.continuous_states()
        first = instance.derivatives()
        instance.set_continuous_states(x * (1.0 + 1e-3) + 1e-6)
        instance.derivatives()
        instance.set_continuous_states(x)
        second = instance.derivatives()
    if np.array_equal(first, second, equal_nan=True):
        return None
    return Finding(
        "derivatives",
        f"the states' derivatives differ by {np.nanmax(np.abs(first - second)):.3g} after a look at other states",
        "they must depend on time, states and inputs alone",
    )


def interfaces_agree(fmu: FmuUnderTest) -> Finding | None:
    """Integrated by CVODE, model exchange gives what co-simulation gives, but for what CVODE's absolute tolerance leaves."""
    if fmu.kind is not Kind.EXCHANGE or fmu.description.coSimulation is None or not fmu.smooth_outputs:
        return None
    exchange, slave = (_simulate(fmu, kind) for kind in ("ModelExchange", "CoSimulation"))
    apart = {}
    for variable in fmu.smooth_outputs:
        name = variable.name
        values = np.interp(slave["time"], exchange["time"], exchange[name])
        scale = max(float(np.abs(slave[name]).max()), INTEGRATION_TOLERANCE / AGREEMENT * size_of(variable))
        apart[name] = float(np.median(np.abs(values - slave[name]))) / scale
    worst = max(apart, key=lambda name: apart[name])
    if apart[worst] <= AGREEMENT:
        return None
    return Finding(
        "interfaces",
        f"{worst} differs by {apart[worst]:.1%} of its largest value between model exchange and co-simulation",
        "both have to solve the same equations",
        Severity.WARNING,
    )


def _simulate(fmu: FmuUnderTest, kind: str) -> Any:
    """fmpy's recording of a short experiment with constant inputs."""
    steps = min(fmu.steps, POINTS)
    return fmpy.simulate_fmu(
        str(fmu.folder),
        fmi_type=kind,
        validate=False,
        model_description=fmu.description,
        start_time=fmu.start,
        stop_time=fmu.start + steps * fmu.step,
        output_interval=fmu.step,
        step_size=fmu.step,
        solver="CVode",
        relative_tolerance=INTEGRATION_TOLERANCE,
        output=[variable.name for variable in fmu.smooth_outputs],
    )
