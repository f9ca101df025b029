"""The section `motor`: what each motor and its gear can do, as their data sheets say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, model_validator

from flexfmu.model.scene.section import NotNegativePerJoint, PositivePerJoint, Section, for_both, quantity

Fraction = Annotated[float, Field(gt=0.0, le=1.0)]
"""Above 0, at most 1."""


@dataclass(frozen=True)
class Motor:
    """A motor and its gear, in SI units; torques and speeds are those of the motor's shaft.

    Attributes:
        continuous_torque: torque that it can hold for ever [N.m].
        peak_torque: largest torque [N.m].
        maximum_speed: largest angular velocity [rad/s].
        rotor_inertia: of the rotor and all that turns with it [kg.m2]; 0 if negligible.
        gear_ratio: turns of the shaft for one of the joint; 1 without a gear.
        gear_efficiency: of the gear, in both directions, above 0 and at most 1.
        torque_constant: torque for a current [N.m/A]; None for no currents and losses.
        winding_resistance: of the winding, between terminals as the torque constant [Ohm]; None for no losses.
        name: for tables.
    """

    continuous_torque: float
    peak_torque: float
    maximum_speed: float
    rotor_inertia: float = 0.0
    gear_ratio: float = 1.0
    gear_efficiency: float = 1.0
    torque_constant: float | None = None
    winding_resistance: float | None = None
    name: str = ""


def _names_for_both(value: Any) -> Any:
    return (value, value) if isinstance(value, str) else tuple(value) if isinstance(value, list) else value


class MotorSection(Section):
    """Motor and gear of each joint: one value for both joints or a list of two; see `Motor`."""

    continuous_torque: Annotated[PositivePerJoint, quantity("N.m")]
    peak_torque: Annotated[PositivePerJoint, quantity("N.m")]
    maximum_speed: Annotated[PositivePerJoint, quantity("rad/s")]
    rotor_inertia: Annotated[NotNegativePerJoint, quantity("kg.m2")] = (0.0, 0.0)
    gear_ratio: Annotated[PositivePerJoint, quantity("1")] = (1.0, 1.0)
    gear_efficiency: Annotated[tuple[Fraction, Fraction], BeforeValidator(for_both), quantity("1")] = (1.0, 1.0)
    torque_constant: Annotated[PositivePerJoint | None, quantity("N.m/A")] = None
    winding_resistance: Annotated[PositivePerJoint | None, quantity("Ohm")] = None
    name: Annotated[tuple[str, str], BeforeValidator(_names_for_both)] = ("", "")

    @model_validator(mode="after")
    def _limits_agree(self) -> Self:
        for peak, continuous in zip(self.peak_torque, self.continuous_torque, strict=True):
            if peak < continuous:
                raise ValueError(
                    f"`peak_torque` must be at least `continuous_torque` = {continuous} N·m, got {peak} N·m"
                )
        if self.winding_resistance is not None and self.torque_constant is None:
            raise ValueError("`winding_resistance` needs `torque_constant` [N.m/A]: losses are those of the current")
        return self

    def of_joint(self, joint: int) -> Motor:
        """The motor of joint 0 or 1."""
        return Motor(**{key: value[joint] for key, value in self.model_dump(exclude_none=True).items()})


def one_table(value: Any) -> Any:
    """The section as one table, where it is written as a list of two, one for each joint: each value becomes a pair.

    Raises:
        ValueError: the list is no pair of tables with the same keys.
    """
    if not isinstance(value, (list, tuple)):
        return value
    if len(value) == 1:
        return value[0]
    if len(value) != 2 or not all(isinstance(each, Mapping) for each in value):
        raise ValueError(f"`motor` is one table for both joints, or a list of two, got a list of {len(value)}")
    first, second = value
    for key in {**first, **second}:
        if key not in first or key not in second:
            lacking = 0 if key in second else 1
            raise ValueError(f"`motor[{lacking}]` has no `{key}`, but the other motor has: give it for both")
    return {key: (first[key], second[key]) for key in first}
