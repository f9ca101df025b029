"""The section `motor`: what each motor and its gear can do, as their data sheets say."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from flexfmu.model.scene.section import NotNegativePerJoint, PositivePerJoint, Section, for_both, quantity
from flexfmu.trajectories.jets import RealArray

Fraction = Annotated[float, Field(gt=0.0, le=1.0)]
"""Above 0, at most 1."""


@dataclass(frozen=True)
class Motor:
    """A motor and its gear, in SI units; torques and speeds are those of the motor's shaft.

    Attributes:
        continuous_torque: torque that it can hold for ever [N.m].
        peak_torque: largest torque [N.m].
        maximum_speed: largest angular velocity [rad/s].
        torque_speed_curve: speeds [rad/s] and largest torques there [N.m], linear in between and constant beyond; empty for the peak torque
            at all speeds.
        thermal_time_constant: of the motor [s], with which its losses heat it up; None for one that is long for a cycle.
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
    torque_speed_curve: tuple[tuple[float, float], ...] = ()
    thermal_time_constant: float | None = None
    name: str = ""

    def largest_torque(self, speed: RealArray) -> tuple[RealArray, RealArray]:
        """The largest torques (N,) [N.m] at speeds (N,) [rad/s] in either direction, and their derivatives by the speed."""
        if not self.torque_speed_curve:
            return np.full(len(speed), self.peak_torque), np.zeros(len(speed))
        speeds, torques = np.array(self.torque_speed_curve).T
        size = np.abs(speed)
        slopes = np.concatenate([[0.0], np.diff(torques) / np.diff(speeds), [0.0]])
        found = np.minimum(np.interp(size, speeds, torques), self.peak_torque)
        slope = np.where(found < self.peak_torque, slopes[np.searchsorted(speeds, size)], 0.0)
        return found, np.sign(speed) * slope

    def heating(self, period: float) -> tuple[float, float]:
        """The largest temperature that the integral of a torque's square can bring when it is repeated with a period [s], for each unit of it [1/s],
        and its derivative by the period.

        With time constant τ the temperature follows the square as a first-order lag. What was u ago counts exp(-u / τ) / (τ (1 - exp(-T / τ))), most at
        u = 0: a bound for any course of the torque. For a long time constant it is 1 / T, and the temperature that of the mean square.
        """
        if self.thermal_time_constant is None:
            return 1.0 / period, -1.0 / period**2
        x = period / self.thermal_time_constant
        weight = -1.0 / (self.thermal_time_constant * math.expm1(-x))
        return weight, -(weight**2) * math.exp(-x)


def _names_for_both(value: Any) -> Any:
    return (value, value) if isinstance(value, str) else tuple(value) if isinstance(value, list) else value


Curve = tuple[tuple[float, float], ...]
"""Speeds [rad/s] and torques there [N.m]."""


def _curves_for_both(value: Any) -> Any:
    """A pair of curves, from one of both motors or from one for each."""

    def is_curve(each: Any) -> bool:
        return isinstance(each, list | tuple) and all(
            isinstance(point, list | tuple) and len(point) == 2 and all(isinstance(x, int | float) for x in point)
            for point in each
        )

    curves = (value, value) if is_curve(value) else value
    if not (isinstance(curves, list | tuple) and len(curves) == 2 and all(map(is_curve, curves))):
        raise ValueError(
            f"must be a list of [speed in rad/s, torque in N·m], or one such list for each joint, got {value!r}"
        )
    for curve in curves:
        speeds, torques = [each[0] for each in curve], [each[1] for each in curve]
        if curve and (
            len(curve) < 2 or speeds[0] < 0.0 or any(a >= b for a, b in pairwise(speeds)) or min(torques) <= 0.0
        ):
            raise ValueError(
                f"needs two or more points of ascending speeds from 0 rad/s on with torques above 0 N·m, got {curve!r}"
            )
    return tuple(tuple(tuple(point) for point in curve) for curve in curves)


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
    torque_speed_curve: Annotated[tuple[Curve, Curve], BeforeValidator(_curves_for_both), quantity("rad/s, N.m")] = (
        (),
        (),
    )
    thermal_time_constant: Annotated[PositivePerJoint | None, quantity("s")] = None
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
