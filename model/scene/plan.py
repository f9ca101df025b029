"""The section `plan`: what `flexfmu plan` shall reach, and what it must keep to."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from math import isfinite
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from flexfmu.model.scene.section import NotNegative, Positive, SecondsOrZero, Section, as_tuple, quantity, tuples

Aim = Literal["time", "torque", "rms_torque", "energy", "residual"]
"""What a plan minimises."""


FrontAxis = Literal["time", "residual", "energy", "power", "rms_torque", "jerk"]
"""A figure that a front weighs against others."""


class Ratio(Section):
    """A limit as a multiple of what the given motion needs."""

    ratio: Annotated[float, quantity("1", gt=0.0)]


class RegionSection(Section):
    """A region that the end effector stays out of; with ``links`` the links too."""

    links: bool = False


class BoxRegion(RegionSection):
    """A rectangle with its sides along x and y, between two opposite corners."""

    kind: Literal["box"]
    corners: Annotated[tuple[tuple[float, float], tuple[float, float]], BeforeValidator(tuples), quantity("m")]

    @model_validator(mode="after")
    def _has_an_area(self) -> Self:
        if any(a == b for a, b in zip(*self.corners, strict=True)):
            raise ValueError(
                f"`corners` are two opposite corners of a box, whose x and y differ; got {[list(each) for each in self.corners]} m"
            )
        return self

    @property
    def outline(self) -> tuple[tuple[float, float], ...]:
        """Corners, counter-clockwise [m]."""
        (x, X), (y, Y) = (sorted(values) for values in zip(*self.corners, strict=True))
        return (x, y), (X, y), (X, Y), (x, Y)


class PolygonRegion(RegionSection):
    """A polygon by its corners, in any sense of rotation."""

    kind: Literal["polygon"]
    points: Annotated[tuple[tuple[float, float], ...], BeforeValidator(tuples), Field(min_length=3), quantity("m")]

    @model_validator(mode="after")
    def _has_an_inside(self) -> Self:
        corners = self.outline
        sides = list(zip(corners, (*corners[1:], *corners[:1]), strict=True))
        if len(corners) < 3 or all(_turn(*sides[0], corner) == 0.0 for corner in corners):
            raise ValueError("`points` lie on one line: a polygon needs three corners that don't")
        for one, other in combinations(sides, 2):
            if _cross(one, other):
                named = " and ".join("({:g}, {:g}) to ({:g}, {:g})".format(*start, *end) for start, end in (one, other))
                raise ValueError(
                    f"sides of `points` cross or touch, {named} m: list the corners in the order of the outline, or name two regions"
                )
        return self

    @property
    def outline(self) -> tuple[tuple[float, float], ...]:
        """Corners [m], without those that repeat the one before."""
        return tuple(
            point
            for point, last in zip(self.points, (*self.points[-1:], *self.points[:-1]), strict=True)
            if point != last
        )


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Twice the signed area of a triangle [m2]: positive if c lies to the left of the line from a to b."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _cross(one: Sequence[tuple[float, float]], other: Sequence[tuple[float, float]]) -> bool:
    """Whether two sides cross within both."""
    (a, b), (c, d) = one, other
    return _turn(a, b, c) * _turn(a, b, d) < 0.0 and _turn(c, d, a) * _turn(c, d, b) < 0.0


FAR = 10.0
"""How far a region without an end reaches [m]."""


class HeightRegion(RegionSection):
    """All that is above, or below, a height for |x - center| < half_width."""

    kind: Literal["above", "below"]
    height: Annotated[float, quantity("m")]
    half_width: Annotated[Positive, quantity("m")]
    center: Annotated[float, quantity("m")] = 0.0

    @property
    def outline(self) -> tuple[tuple[float, float], ...]:
        """Corners, counter-clockwise [m]."""
        x, X = self.center - self.half_width, self.center + self.half_width
        y, Y = sorted((self.height, self.height + (FAR if self.kind == "above" else -FAR)))
        return (x, y), (X, y), (X, Y), (x, Y)


Region = Annotated[BoxRegion | PolygonRegion | HeightRegion, Field(discriminator="kind")]


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def _limit(value: Any) -> Any:
    """Tell in one sentence what a limit may be; pydantic tells one for each form."""
    ratio: Any = value.get("ratio") if isinstance(value, dict) and len(value) == 1 else value
    if value is None or value == "free":
        # files have no null, and without the key the default would hold
        return "free"
    if isinstance(value, Ratio) or (_number(ratio) and ratio > 0.0):
        return value
    raise ValueError(
        f'a limit must be above 0, a number in SI units, {{ ratio = 1.0 }} of the given motion\'s or "free", got {value!r}'
    )


def _band(value: Any) -> Any:
    """Tell in one sentence what a band of payloads may be."""
    if _number(value) and 0.0 <= value < 1.0:
        return value
    if isinstance(value, list | tuple) and len(value) == 2 and all(_number(each) and each >= 0.0 for each in value):
        return tuple(value)
    form = list(value) if isinstance(value, tuple) else value
    raise ValueError(
        f"must be a fraction to both sides, from 0 to below 1, or [lightest, heaviest] in kg, from 0, got {form!r}"
    )


Limit = Annotated[Positive | Ratio | Literal["free"] | None, BeforeValidator(_limit)]
"""A limit in an SI unit, `{ ratio = 1.0 }` of the given motion's value, or ``free`` for no limit."""


class PlanLimits(Section):
    """Limits of the planned motion, in SI units or as `{ ratio = 1.0 }` of what the given motion needs.

    The default keeps the references to 2.5 times the given motion's speed, acceleration and jerk, and the motors to what the section
    `motor` says or, without it, torques, their RMS values and the power of each motor to those of the given motion at the same payload.
    ``supply_power`` and ``regenerated_power`` are those of both motors together, ``energy`` what they give in a run, without what they take
    back, and ``regenerated_energy`` what flows back. ``motor_torque``, ``motor_rms_torque`` and ``motor_speed`` are those of the shafts,
    relative to what the motors can.
    """

    torque: Annotated[Limit, quantity("N.m")] = None
    speed: Annotated[Limit, quantity("rad/s")] = Ratio(ratio=2.5)
    acceleration: Annotated[Limit, quantity("rad/s2")] = Ratio(ratio=2.5)
    jerk: Annotated[Limit, quantity("rad/s3")] = Ratio(ratio=2.5)
    rms_torque: Annotated[Limit, quantity("N.m")] = None
    power: Annotated[Limit, quantity("W")] = None
    motor_torque: Annotated[Limit, quantity("1")] = None
    motor_rms_torque: Annotated[Limit, quantity("1")] = None
    motor_speed: Annotated[Limit, quantity("1")] = None
    energy: Annotated[Limit, quantity("J")] = None
    supply_power: Annotated[Limit, quantity("W")] = None
    regenerated_power: Annotated[Limit, quantity("W")] = None
    regenerated_energy: Annotated[Limit, quantity("J")] = None
    reaction: Annotated[Limit, quantity("N")] = None
    stress: Annotated[Limit, quantity("Pa")] = None
    off_path: Annotated[Positive | None, quantity("m")] = None


class TargetSection(Section):
    """A further place of a cycle, the payload that is carried there, and the time at rest there; by default that of the cycle."""

    position: Annotated[tuple[float, float], BeforeValidator(as_tuple), quantity("m")]
    payload: Annotated[NotNegative, quantity("kg")]
    pause: Annotated[NotNegative | None, quantity("s")] = None


class CycleSection(Section):
    """A cycle: the scene's motion with its payload, then to each of `targets`, and back to the start with `return_payload`.

    The robot rests for `pause` at each place.
    """

    return_payload: Annotated[NotNegative, quantity("kg")] = 0.0
    pause: SecondsOrZero = 0.1
    targets: Annotated[tuple[TargetSection, ...], BeforeValidator(as_tuple)] = ()


class PlanSection(Section):
    """The wishes for a planned motion; all have defaults."""

    minimise: Aim = "time"
    duration: Annotated[Positive | None, quantity("s")] = None
    cycle: CycleSection | None = None
    residual: Annotated[Positive, quantity("m")] = 1e-6
    settled_within: SecondsOrZero = 0.0
    payload_band: Annotated[
        Annotated[float, Field(ge=0.0, lt=1.0)] | tuple[NotNegative, NotNegative],
        BeforeValidator(_band),
        quantity("1 or kg"),
    ] = 0.3
    stiffness_band: Annotated[float, quantity("1", ge=0.0, lt=1.0)] = 0.0
    damping_band: Annotated[float, quantity("1", ge=0.0, lt=1.0)] = 0.0
    margin: Annotated[Positive, quantity("m")] = 1e-4
    corridor: Annotated[float, quantity("m", ge=0.0)] = 0.01
    keep_out: Annotated[tuple[Region, ...] | None, BeforeValidator(as_tuple)] = None
    limits: PlanLimits = PlanLimits()
    front: Annotated[tuple[FrontAxis, ...], BeforeValidator(as_tuple)] = ()
    seed: Annotated[int, Field(ge=0, lt=2**20)] = 0

    @model_validator(mode="after")
    def _front_has_what_is_minimised(self) -> Self:
        axes = self.front
        if axes and (len({*axes}) != len(axes) or not 2 <= len(axes) <= 3):
            raise ValueError(f"`front` is two or three different figures, got {list(axes)}")
        # a given duration has no levels
        is_timed = "time" in axes and self.minimise != "time"
        if axes and (self.minimise == "residual" or self.minimise not in axes or is_timed):
            raise ValueError(
                f'`front` = {list(axes)} needs what is minimised, `minimise = "{self.minimise}"`, among its figures: time, or in its '
                f"place with a `duration` energy or rms_torque"
            )
        return self

    @model_validator(mode="after")
    def _duration_goes_with_its_aim(self) -> Self:
        if (self.duration is None) != (self.minimise == "time"):
            if self.minimise == "time":
                raise ValueError(
                    f'`duration` = {self.duration} s and `minimise = "time"` contradict each other: leave one out'
                )
            raise ValueError(f'`minimise = "{self.minimise}"` needs `duration`, the total time in s')
        return self

    @model_validator(mode="after")
    def _band_ascends(self) -> Self:
        if isinstance(self.payload_band, tuple) and self.payload_band[0] > self.payload_band[1]:
            raise ValueError(
                f"`payload_band` is the lightest and the heaviest payload in kg, got {list(self.payload_band)}"
            )
        return self
