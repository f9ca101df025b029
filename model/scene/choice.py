"""Keys for the automatic choice of effects: the request in the scene, and the result, which `flexfmu` writes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator

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
"""Metrics whose error an automatic choice can limit."""

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

MeasureNames = Annotated[tuple[MeasureName, ...], BeforeValidator(as_tuple)]

LOOSEST_INTEGRATOR = 1e-3
"""Largest FMU tolerance of an automatic choice: 1e-2 would save only 2 % of the time, and its error would hide that
of neglected effects."""


Shares = Annotated[tuple[float, ...], BeforeValidator(as_tuple)]
"""A relative change for each metric of the choice, in the same order."""


class EstimatedEffect(Section):
    """One effect of an automatic choice, with its relative contribution to each metric of the choice."""

    effect: str
    change: str
    chosen: bool
    contribution: Shares


class ChoiceSection(Section):
    """Result of an automatic choice of effects; written by `flexfmu`, not by hand.

    `error` is the estimated error of each metric due to neglected effects, relative to the metric's scale. `verified` is the error
    of the run against that of the richest set, of effects and integration together: of the scene as it runs, or of its motion alone
    where its loop can't run.
    """

    tolerance: ChoiceTolerance
    of: MeasureNames
    error: Shares
    verified: Shares | None = None
    verified_in: Literal["scene", "motion"] = "scene"
    effects: Annotated[tuple[EstimatedEffect, ...], BeforeValidator(as_tuple)]


def integrator_tolerance(tolerance: float) -> float:
    """The relative tolerance of the FMU for a tolerance of the choice, within the limits of the FMU."""
    return max(LEAST_TOLERANCE, min(INTEGRATOR_SHARE * tolerance, LOOSEST_INTEGRATOR))


def fill_in(effects: Any, cosimulation: Any) -> tuple[Any, Any]:
    """The sections `effects` and `cosimulation` of a scene file with the default values for `select = "auto"`."""
    if not isinstance(effects, Mapping) or effects.get("select") != "auto":
        return effects, cosimulation
    tolerance = effects.get("tolerance")
    if isinstance(cosimulation, Mapping):  # an error in this tolerance is reported once, for its own key
        number = tolerance if isinstance(tolerance, float | int) else LARGEST
        cosimulation = {"tolerance": integrator_tolerance(number), **cosimulation}
    return {"basis": "craig-bampton", **effects}, cosimulation


def contradictions(
    select: str | None, given: Mapping[str, object], basis: str, switched_on: tuple[str, ...]
) -> Iterator[str]:
    """A sentence for each key that contradicts an automatic choice, or requires one that is missing.

    Args:
        select: ``auto`` or None.
        given: values of the keys `tolerance` and `of`, None where the scene doesn't have them.
        basis: basis of the mode shapes.
        switched_on: keys of elastic effects that the scene sets.
    """
    # keys of a choice without `select`, or `select` without these keys
    for key, value in given.items():
        if select is None and value is not None:
            yield f'`{key}` belongs to `select = "auto"`: add that, or remove `{key}`'
        if select == "auto" and not value:
            yield f'`{key}` is missing: `select = "auto"` needs `tolerance = 0.01` and `of = ["peak_position_error"]`'
    if select is None:
        return
    # keys that an automatic choice excludes
    if switched_on:
        keys = ", ".join(f"`{key}`" for key in switched_on)
        yield f'`select = "auto"` chooses {keys}: remove {"it" if len(switched_on) == 1 else "them"}, or remove `select`'
    if basis != "craig-bampton":
        yield (
            f'`select = "auto"` needs `basis = "craig-bampton"`, whose few shapes converge, got {basis!r}: leave `basis` out'
        )
