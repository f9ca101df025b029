"""Keys for the automatic choice of effects and of numerical settings: the requests in the scene, and the result, which `flexfmu` writes."""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, BeforeValidator

from flexfmu.model.scene.cosimulation import LEAST_TOLERANCE
from flexfmu.model.scene.section import Section, as_tuple, quantity

MeasureName = Literal[
    "peak_torque_1",
    "peak_torque_2",
    "peak_position_error",
    "rms_acceleration_error",
    "end_position_error",
    "residual_vibration_amplitude",
    "residual_vibration_rms",
]
"""Metrics whose error an automatic choice estimates; of other metrics runs alone show it."""

MEASURES: tuple[MeasureName, ...] = get_args(MeasureName)

INTEGRATOR_SHARE = 0.5
"""Share of the tolerance for the integration error; the rest is for neglected effects."""

NAMED_FLOOR = 1e-4
"""Smallest scale of a position metric that the user named, as a fraction of the peak position error: no run resolves smaller values."""

DEFAULT_TOLERANCE = 0.01
"""Tolerance where neither scene nor command gives one."""

SMALLEST, LARGEST = LEAST_TOLERANCE / INTEGRATOR_SHARE, 10.0
"""Limits of the tolerance of a choice."""

ChoiceTolerance = Annotated[float, quantity("1", ge=SMALLEST, le=LARGEST)]
"""Relative error; from 1 on, all deflections may be neglected."""

MetricNames = Annotated[tuple[str, ...], BeforeValidator(as_tuple)]
"""Any metrics of a scene, margins of its loop included."""

LOOSEST_INTEGRATOR = 1e-3
"""Largest FMU tolerance of an automatic choice: 1e-2 would save only 2 % of the time, and its error would hide that
of neglected effects."""


Shares = Annotated[tuple[float | None, ...], BeforeValidator(as_tuple)]
"""A relative change for each metric of the choice, in the same order; None for one that isn't estimated."""


def _asked(value: Any) -> float | str:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f'give a relative error, 1e-3, or an absolute one with its unit, "1 um"; got {value!r}')
    if not isinstance(value, str) and not 0.0 < value < 1.0:
        raise ValueError(
            f'a relative error is above 0 and below 1, got {value!r}; an absolute one is a text with its unit, "1 um"'
        )
    return value if isinstance(value, str) else float(value)


Accuracy = Annotated[
    dict[str, Annotated[float | str, BeforeValidator(_asked)]] | None, AfterValidator(lambda asked: asked or None)
]
"""Metric → largest error of a run, of model and numerics together: relative, a number, or absolute, a text with its unit; None for an
empty table."""


class EstimatedEffect(Section):
    """One effect of an automatic choice, with its relative contribution to each metric of the choice."""

    effect: str
    change: str
    chosen: bool
    contribution: Shares


class ChoiceSection(Section):
    """Result of an automatic choice of effects; written by `flexfmu`, not by hand.

    `error` is the estimated error of each metric due to neglected effects, relative to the metric's scale. `verified` bounds the error
    of the run against that of the richest set, of effects and integration together: of the scene as it runs, or of its motion alone
    where its loop can't run.
    """

    tolerance: ChoiceTolerance
    of: MetricNames
    error: Shares
    verified: Shares | None = None
    verified_in: Literal["scene", "motion"] = "scene"
    effects: Annotated[tuple[EstimatedEffect, ...], BeforeValidator(as_tuple)]


def integrator_tolerance(tolerance: float) -> float:
    """The relative tolerance of the FMU for a tolerance of the choice, within the limits of the FMU."""
    return max(LEAST_TOLERANCE, min(INTEGRATOR_SHARE * tolerance, LOOSEST_INTEGRATOR))
