"""The choice of the integration method as FMI shows it; the numbers are those of ``c-runtime/methods.h``."""

from __future__ import annotations

from flexfmu.fmu_build.choices import Choice

LEAST_TOLERANCE = 1e-12
"""Smaller tolerances count as this one, see ``c-runtime/plant_backend.c``."""

FIXED_STEP = "integrator.step"
"""Name of the parameter that fixes the step size [s]; 0 lets the error choose it."""

VALUE_REFERENCE = 6
"""Of the choice, among the Integer variables: behind ``initial`` and the counters."""

INTEGRATOR = Choice(
    "integrator",
    "Integration method",
    {
        "automatic": (
            1,
            "the cheapest of radau3, gauss3 and gauss4 for the tolerance; no radau3 where nothing damps the vibrations",
        ),
        "gauss2": (2, "Gauss collocation, 2 stages, order 4, A-stable, without damping of its own"),
        "gauss3": (3, "Gauss collocation, 3 stages, order 6, A-stable, without damping of its own"),
        "gauss4": (4, "Gauss collocation, 4 stages, order 8, A-stable, without damping of its own"),
        "radau3": (5, "Radau IIA, 3 stages, order 5, L-stable: damps what it does not resolve"),
        "dopri5": (6, "Dormand-Prince, explicit, order 5 with an error estimate of order 4"),
        "rk4": (7, "Classical Runge-Kutta method, explicit, order 4"),
    },
)
"""The parameter that chooses the method."""
