"""Keys of an automatic choice of effects: the request in the scene, and the result that `flexfmu` writes."""

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
"""Metrics whose accuracy an automatic choice can guarantee."""

MEASURES: tuple[MeasureName, ...] = get_args(MeasureName)

INTEGRATOR_SHARE = 0.5
"""Share of the tolerance for the integrator's error; the rest is for the effects left out."""

DEFAULT_TOLERANCE = 0.01
"""Relative error where neither scene nor command names one."""

SMALLEST, LARGEST = LEAST_TOLERANCE / INTEGRATOR_SHARE, 10.0
"""Limits of the tolerance for effects."""

ChoiceTolerance = Annotated[float, quantity("1", ge=SMALLEST, le=LARGEST)]
"""Relative error; from 1 on even a deflection that is left out altogether is tolerable."""

MeasureNames = Annotated[tuple[MeasureName, ...], BeforeValidator(as_tuple)]

LOOSEST_INTEGRATOR = 1e-3
"""Largest tolerance that an automatic choice gives the FMU; one of 1e-2 would save 2 % of the time, and hide what the effects cost
in accuracy behind the integrator's error."""


Shares = Annotated[tuple[float, ...], BeforeValidator(as_tuple)]
"""One relative change for each metric of the choice, in their order."""


class EstimatedEffect(Section):
    """One effect of an automatic choice: what it changes in each metric of the choice, relative to the metric's scale."""

    effect: str
    change: str
    chosen: bool
    contribution: Shares


class ChoiceSection(Section):
    """How the effects of a scene were chosen; written by `flexfmu`, not by hand.

    `error` is the estimated error of each metric because of what is left out, relative to the metric's scale.
    """

    tolerance: ChoiceTolerance
    of: MeasureNames
    error: Shares
    effects: Annotated[tuple[EstimatedEffect, ...], BeforeValidator(as_tuple)]


def integrator_tolerance(tolerance: float) -> float:
    """The FMU's relative tolerance that goes with a tolerance for effects; always one that it can keep."""
    return max(LEAST_TOLERANCE, min(INTEGRATOR_SHARE * tolerance, LOOSEST_INTEGRATOR))


def fill_in(effects: Any, cosimulation: Any) -> tuple[Any, Any]:
    """The sections `effects` and `cosimulation` of a scene file, with what follows from `select = "auto"`."""
    if not isinstance(effects, Mapping) or effects.get("select") != "auto":
        return effects, cosimulation
    tolerance = effects.get("tolerance")
    if isinstance(cosimulation, Mapping):  # a wrong tolerance for effects is reported by that key alone
        number = tolerance if isinstance(tolerance, float | int) else LARGEST
        cosimulation = {"tolerance": integrator_tolerance(number), **cosimulation}
    return {"basis": "craig-bampton", **effects}, cosimulation


def contradictions(
    select: str | None, given: Mapping[str, object], basis: str, switched_on: tuple[str, ...]
) -> Iterator[str]:
    """One sentence for each key that contradicts an automatic choice, or has no meaning without one.

    Args:
        select: ``auto`` or None.
        given: the keys `tolerance` and `of` with their values, None where the scene doesn't give them.
        basis: of the shapes.
        switched_on: keys of effects that the scene itself chooses.
    """
    # keys of the choice without a choice, and the other way round
    for key, value in given.items():
        if select is None and value is not None:
            yield f'`{key}` belongs to `select = "auto"`: add that, or remove `{key}`'
        if select == "auto" and not value:
            yield f'`{key}` is missing: `select = "auto"` needs `tolerance = 0.01` and `of = ["peak_position_error"]`'
    if select is None:
        return
    # what an automatic choice leaves no room for
    if switched_on:
        keys = ", ".join(f"`{key}`" for key in switched_on)
        yield f'`select = "auto"` chooses {keys}: remove {"it" if len(switched_on) == 1 else "them"}, or remove `select`'
    if basis != "craig-bampton":
        yield (
            f'`select = "auto"` needs `basis = "craig-bampton"`, whose few shapes converge, got {basis!r}: leave `basis` out'
        )
