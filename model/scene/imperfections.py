"""Sections of the scene file for imperfections: `[[imperfection]]` tables; `kind` determines their keys."""

from __future__ import annotations

from operator import lt
from typing import Annotated, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from flexfmu.model.scene import section
from flexfmu.model.scene.loop import LoopSection, OwnPart


class SignalSection(LoopSection):
    """An imperfection of a signal of both joints: torques, measured positions, measured velocities or references.

    Of the references, a delay acts on positions, velocities and accelerations, any other imperfection on positions
    alone. The default sample time is that of the first controller with one (of a cascade, of the loop that
    exchanges the signal), else the communication step; a lag needs none.
    """

    signal: Literal["torque", "position", "velocity", "reference"]
    sample_time: Annotated[section.Positive | None, section.quantity("s")] = None
    offset: section.SecondsOrZero = 0.0


class SaturationSection(SignalSection):
    """Saturation of the signal to ± `limit`, or to `lower` and `upper`, in the signal's unit."""

    kind: Literal["saturation"]
    signal: Literal["torque", "position", "velocity", "reference"] = "torque"
    limit: section.PositivePerJoint | None = None
    lower: section.PerJoint | None = None
    upper: section.PerJoint | None = None

    @model_validator(mode="after")
    def _one_kind_of_limits(self) -> Self:
        two_sided = self.lower is not None and self.upper is not None
        if (self.limit is None) != two_sided or (self.lower is None) != (self.upper is None):
            raise ValueError("give either `limit`, which holds both ways, or `lower` and `upper`")
        if self.lower is not None and self.upper is not None and not all(map(lt, self.lower, self.upper)):
            raise ValueError(f"`lower` must be below `upper`, got {list(self.lower)} and {list(self.upper)}")
        return self

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lower and upper limits of both joints."""
        if self.lower is not None and self.upper is not None:
            return self.lower, self.upper
        first, second = self.limit or (0.0, 0.0)
        return (-first, -second), (first, second)


class RateLimitSection(SignalSection):
    """Rate limit of the signal: `rate` rising, `falling_rate` (by default `rate`) falling, in its unit per second."""

    kind: Literal["rate-limit"]
    signal: Literal["torque", "position", "velocity", "reference"] = "torque"
    rate: section.PositivePerJoint
    falling_rate: section.PositivePerJoint | None = None


class DeadZoneSection(SignalSection):
    """Dead zone: the signal is zero within ± `half_width`, and less by it beyond; in its unit."""

    kind: Literal["dead-zone"]
    signal: Literal["torque", "position", "velocity", "reference"] = "torque"
    half_width: section.NotNegativePerJoint


class BacklashSection(SignalSection):
    """Backlash: the signal stands still while its source goes through `gap`, in its unit."""

    kind: Literal["backlash"]
    signal: Literal["torque", "position", "velocity", "reference"] = "position"
    gap: section.NotNegativePerJoint


class LinearSection(section.Section):
    """Linear interpolation between two samples."""

    kind: Literal["linear"] = "linear"
    order: ClassVar[int] = 1


class LagrangeSection(section.Section):
    """Lagrange interpolation: polynomial through `order` + 1 samples."""

    kind: Literal["lagrange"]
    order: Annotated[int, section.quantity("1", ge=1, le=10)]


class ThiranSection(section.Section):
    """Thiran all-pass filter of this order, which changes no amplitude."""

    kind: Literal["thiran"]
    order: Annotated[int, section.quantity("1", ge=1, le=10)]


InterpolationSection = Annotated[
    LinearSection | LagrangeSection | ThiranSection, BeforeValidator(section.named_kind), Field(discriminator="kind")
]


class DelaySection(SignalSection):
    """Delay of the signal by `time`.

    For fractions of a sample, `interpolation` is "linear", `{ kind = "lagrange", order = 3 }` or
    `{ kind = "thiran", order = 2 }`. A `known` delay of a measurement delays the references of the same kind as well, as of
    controllers that know its time stamps: they compare what belongs to the same instant. With a `longest` delay the
    block keeps samples for that one, and `time` is a tunable parameter of it.
    """

    kind: Literal["delay"]
    signal: Literal["torque", "position", "velocity", "reference"] = "torque"
    time: section.SecondsOrZero
    interpolation: InterpolationSection = LinearSection()
    known: bool = False
    longest: section.SecondsOrZero | None = None

    @model_validator(mode="after")
    def _tunable_are_linear(self) -> Self:
        if self.longest is None:
            return self
        if self.interpolation.kind != "linear":
            raise ValueError(f'a `longest` delay needs `interpolation = "linear"`, got "{self.interpolation.kind}"')
        if self.longest < self.time:
            raise ValueError(f"`longest` must be at least `time`, {self.time:g} s, got {self.longest:g} s")
        return self

    @model_validator(mode="after")
    def _known_are_measurements(self) -> Self:
        if self.known and self.signal not in ("position", "velocity"):
            raise ValueError(f'a `known` delay is one of `signal = "position"` or "velocity", got "{self.signal}"')
        return self


class QuantisationSection(SignalSection):
    """The signal rounded to multiples of `resolution`, in its unit, as by an encoder."""

    kind: Literal["quantisation"]
    signal: Literal["torque", "position", "velocity", "reference"] = "position"
    resolution: section.PositivePerJoint


class EncoderSection(LoopSection):
    """Incremental encoders of both joints: angles rounded to counts, velocities as change over `window` samples."""

    kind: Literal["encoder"]
    counts_per_turn: Annotated[float, section.quantity("1", ge=1.0)]
    window: Annotated[int, section.quantity("samples", ge=1)] = 1
    sample_time: Annotated[section.Positive | None, section.quantity("s")] = None
    offset: section.SecondsOrZero = 0.0


class NoiseSection(SignalSection):
    """White noise in the signal's unit: normal with a `standard_deviation`, or uniform within ± `half_width`.

    The random numbers depend on `seed`, the section's name and the signal. Sections without a name are called `noise`,
    `noise2` and so on in the order of the file, so that each has its own random numbers.
    """

    kind: Literal["noise"]
    signal: Literal["torque", "position", "velocity", "reference"] = "position"
    standard_deviation: section.NotNegativePerJoint | None = None
    half_width: section.NotNegativePerJoint | None = None
    seed: Annotated[int, Field(ge=0, lt=2**20)] = 0

    @model_validator(mode="after")
    def _one_distribution(self) -> Self:
        if (self.standard_deviation is None) == (self.half_width is None):
            raise ValueError("give either `standard_deviation`, for normal noise, or `half_width`, for uniform noise")
        return self


class JitterSection(SignalSection):
    """Samples with a random delay of up to `time`; `seed` and names as for noise (`jitter`, `jitter2` and so on)."""

    kind: Literal["jitter"]
    signal: Literal["torque", "position", "velocity", "reference"] = "position"
    time: section.Seconds
    seed: Annotated[int, Field(ge=0, lt=2**20)] = 0


class LagSection(SignalSection):
    """First-order lag, as of a current loop: in continuous time, or sampled with a `sample_time`."""

    kind: Literal["lag"]
    signal: Literal["torque", "position", "velocity", "reference"] = "torque"
    time_constant: section.Seconds

    @model_validator(mode="after")
    def _offset_has_a_sample_time(self) -> Self:
        if self.offset and self.sample_time is None:
            raise ValueError(
                f"an `offset` of {self.offset:g} s needs a `sample_time` in s; leave both out for continuous time"
            )
        return self


class PayloadErrorSection(section.Section):
    """The real payload is (1 + relative) times the one that planning, controllers and shapers assume."""

    kind: Literal["payload-error"]
    relative: Annotated[float, section.quantity("1", ge=-1.0)]


class ParameterErrorSection(section.Section):
    """The real robot has other `parameters` than planning, controllers and shapers assume; keys are those of the scene."""

    kind: Literal["parameter-error"]
    parameters: Annotated[dict[str, float], Field(min_length=1)]

    def __hash__(self) -> int:
        """That of the values, as scenes are keys of caches."""
        return hash(tuple(self.parameters.items()))


ImperfectionSection = Annotated[
    SaturationSection
    | RateLimitSection
    | DeadZoneSection
    | BacklashSection
    | DelaySection
    | QuantisationSection
    | EncoderSection
    | NoiseSection
    | JitterSection
    | LagSection
    | PayloadErrorSection
    | ParameterErrorSection
    | OwnPart,
    Field(discriminator="kind"),
]
