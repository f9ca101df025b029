"""Sections of the scene file for what stands between trajectory and robot: controllers, shapers and imperfections.

Each is an array of tables, `[[controller]]` and so on, whose `kind` decides which keys it has.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from flexfmu.model.section import (
    NotNegative,
    NotNegativePerJoint,
    Positive,
    PositivePerJoint,
    Seconds,
    SecondsOrZero,
    Section,
    as_tuple,
    quantity,
)

Name = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")]
Matrix = Annotated[tuple[Annotated[tuple[float, ...], BeforeValidator(as_tuple)], ...], BeforeValidator(as_tuple)]
Names = Annotated[tuple[str, ...], BeforeValidator(as_tuple)]
Pose = Annotated[tuple[float, float], BeforeValidator(as_tuple), quantity("m")]
TorqueLimit = Annotated[PositivePerJoint | None, quantity("N.m")]


class LoopSection(Section):
    """Something with signals: its name in the system, and connections that names alone don't make.

    `connect` maps an input to its source: `{ "error" = "joint1.position" }`, or with the names of the slaves
    `{ "plant.joint1.torque" = "mine.torque" }`.
    """

    name: Name | None = None
    connect: dict[str, str] = Field(default_factory=dict)

    def __hash__(self) -> int:
        return hash(self.model_dump_json())


class SampledSection(LoopSection):
    """Something with a sample time of its own."""

    sample_time: Seconds
    offset: SecondsOrZero = 0.0


class PythonSection(LoopSection):
    """A slave, block or python-control system that a Python function or class returns.

    `source` is `module:name`; modules in the working directory are found too.
    """

    kind: Literal["python"]
    source: Annotated[str, Field(pattern=r"^[\w.]+:[\w.]+$")]
    arguments: dict[str, Any] = Field(default_factory=dict)


class FmuSection(LoopSection):
    """Any FMI 2.0 co-simulation FMU; `path` from the working directory."""

    kind: Literal["fmu"]
    path: str
    parameters: dict[str, float | int | bool | str] = Field(default_factory=dict)


class PdSection(SampledSection):
    """Torque = proportional * position error + derivative * velocity error."""

    kind: Literal["pd"]
    proportional: Annotated[NotNegativePerJoint, quantity("N.m/rad")]
    derivative: Annotated[NotNegativePerJoint, quantity("N.m.s/rad")]
    torque_limit: TorqueLimit = None


class PidSection(SampledSection):
    """PID from the measured angles; the integral is held where it would drive the torque further into its limit."""

    kind: Literal["pid"]
    proportional: Annotated[NotNegativePerJoint, quantity("N.m/rad")]
    integral: Annotated[NotNegativePerJoint, quantity("N.m/(rad.s)")]
    derivative: Annotated[NotNegativePerJoint, quantity("N.m.s/rad")]
    filter_time: Annotated[NotNegativePerJoint, quantity("s")] = (0.0, 0.0)
    setpoint_weight: float = 1.0
    derivative_weight: float = 1.0
    torque_limit: TorqueLimit = None


class ComputedTorqueSection(SampledSection):
    """Rigid inverse dynamics of the reference acceleration with PD correction; `payload` is the mass that it reckons
    with, the scene's own by default."""

    kind: Literal["computed-torque"]
    proportional: Annotated[NotNegativePerJoint, quantity("1/s2")]
    derivative: Annotated[NotNegativePerJoint, quantity("1/s")]
    payload: Annotated[NotNegative | None, quantity("kg")] = None
    torque_limit: TorqueLimit = None


class FeedforwardSection(SampledSection):
    """Rigid inverse dynamics of the reference motion, added to the torque of another controller."""

    kind: Literal["feedforward"]
    payload: Annotated[NotNegative | None, quantity("kg")] = None


class StateFeedbackSection(SampledSection):
    """Linear-quadratic regulator with a Kalman filter, designed on the robot linearised at a pose.

    The cost is the mean of (position error / position_error)² + (velocity error / velocity_error)² + (torque deviation /
    torque_deviation)² over both joints; the filter expects torque noise and measurement noise of these standard
    deviations.
    """

    kind: Literal["state-feedback"]
    pose: Literal["start", "middle", "end"] = "end"
    position_error: Annotated[PositivePerJoint, quantity("rad")] = (1e-3, 1e-3)
    velocity_error: Annotated[PositivePerJoint, quantity("rad/s")] = (0.1, 0.1)
    torque_deviation: Annotated[PositivePerJoint, quantity("N.m")] = (10.0, 10.0)
    torque_noise: Annotated[Positive, quantity("N.m")] = 1.0
    measurement_noise: Annotated[Positive, quantity("rad")] = 1e-5
    torque_limit: TorqueLimit = None


class StateSpaceSection(SampledSection):
    """x_k+1 = A x_k + B u_k, y_k = C x_k + D u_k with signals named like those of the robot."""

    kind: Literal["state-space"]
    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix | None = None
    inputs: Names
    outputs: Names


ControllerSection = Annotated[
    PdSection
    | PidSection
    | ComputedTorqueSection
    | FeedforwardSection
    | StateFeedbackSection
    | StateSpaceSection
    | PythonSection
    | FmuSection,
    Field(discriminator="kind"),
]


class Mode(Section):
    """A vibration mode: undamped natural frequency and damping ratio."""

    frequency: Annotated[float, quantity("Hz", gt=0.0)]
    ratio: Annotated[float, quantity("1", ge=0.0, lt=1.0)] = 0.0


def _modes(value: Any) -> Any:
    """`along-path` is the same as leaving the modes out."""
    if value is None or value == "along-path":
        return None
    if isinstance(value, (list, tuple)) and value:
        return tuple(value)
    raise ValueError(
        f'give "along-path" or a list of {{ frequency = 58.0, ratio = 0.1 }}, frequencies in Hz, got {value!r}'
    )


ShaperKind = Literal["zv", "zvd", "zvdd", "zvddd", "mzv", "ei", "2-hump-ei", "3-hump-ei", "um-zv"]


class ImpulseShaperSection(LoopSection):
    """An input shaper, on the joint references, on the motion along the path (which keeps the path), or as a sampled
    slave on the joint references.

    `modes` are those to suppress; without them the lowest `mode_count` of the robot along its path.
    """

    kind: ShaperKind
    apply: Literal["joints", "path", "sampled"] = "joints"
    modes: Annotated[tuple[Mode, ...] | None, BeforeValidator(_modes)] = None
    mode_count: Annotated[int, quantity("modes", ge=1, le=8)] = 1
    sample_time: Annotated[Positive | None, quantity("s")] = None
    offset: SecondsOrZero = 0.0

    @model_validator(mode="after")
    def _sampled_has_a_sample_time(self) -> Self:
        if (self.apply == "sampled") != (self.sample_time is not None):
            raise ValueError(
                '`sample_time` in s goes with `apply = "sampled"` and with nothing else, '
                f'got {self.sample_time} with apply = "{self.apply}"'
            )
        return self


ShaperSection = Annotated[ImpulseShaperSection | PythonSection | FmuSection, Field(discriminator="kind")]


class SignalSection(LoopSection):
    """Something that signals of both joints pass: the motors' torques, the measured positions or velocities, or the
    references (all of them where it delays, the positions alone otherwise).

    The sample time is that of the first controller with one, else the communication step.
    """

    signal: Literal["torque", "position", "velocity", "reference"]
    sample_time: Annotated[Positive | None, quantity("s")] = None
    offset: SecondsOrZero = 0.0


class SaturationSection(SignalSection):
    """The signal within ± limit, in its own unit."""

    kind: Literal["saturation"]
    signal: Literal["torque", "position", "velocity", "reference"] = "torque"
    limit: PositivePerJoint


class RateLimitSection(SignalSection):
    """The signal changes by no more than `rate`, in its own unit per second."""

    kind: Literal["rate-limit"]
    signal: Literal["torque", "position", "velocity", "reference"] = "torque"
    rate: PositivePerJoint


class DelaySection(SignalSection):
    """The signal as it was `time` ago; fractions of a sample are interpolated."""

    kind: Literal["delay"]
    signal: Literal["torque", "position", "velocity", "reference"] = "torque"
    time: SecondsOrZero


class QuantisationSection(SignalSection):
    """The signal rounded to multiples of `resolution`, in its own unit, as an encoder does."""

    kind: Literal["quantisation"]
    signal: Literal["torque", "position", "velocity", "reference"] = "position"
    resolution: PositivePerJoint


class EncoderSection(LoopSection):
    """Incremental encoders of both joints: the angle to the nearest of `counts_per_turn`, the velocity from the change over
    `window` samples."""

    kind: Literal["encoder"]
    counts_per_turn: Annotated[float, quantity("1", ge=1.0)]
    window: Annotated[int, quantity("samples", ge=1)] = 1
    sample_time: Annotated[Positive | None, quantity("s")] = None
    offset: SecondsOrZero = 0.0


class NoiseSection(SignalSection):
    """White normal noise of a standard deviation in the signal's unit, the same for the same seed."""

    kind: Literal["noise"]
    signal: Literal["torque", "position", "velocity", "reference"] = "position"
    standard_deviation: NotNegativePerJoint
    seed: Annotated[int, Field(ge=0, lt=2**20)] = 0


class JitterSection(SignalSection):
    """Samples taken up to `time` late at random, the same for the same seed."""

    kind: Literal["jitter"]
    signal: Literal["torque", "position", "velocity", "reference"] = "position"
    time: Seconds
    seed: Annotated[int, Field(ge=0, lt=2**20)] = 0


class LagSection(SignalSection):
    """First-order lag, as a current loop has it."""

    kind: Literal["lag"]
    signal: Literal["torque", "position", "velocity", "reference"] = "torque"
    time_constant: Seconds


class PayloadErrorSection(Section):
    """The robot carries (1 + relative) times the scene's payload, and nothing else knows of it."""

    kind: Literal["payload-error"]
    relative: Annotated[float, quantity("1", ge=-1.0)]


ImperfectionSection = Annotated[
    SaturationSection
    | RateLimitSection
    | DelaySection
    | QuantisationSection
    | EncoderSection
    | NoiseSection
    | JitterSection
    | LagSection
    | PayloadErrorSection
    | PythonSection
    | FmuSection,
    Field(discriminator="kind"),
]
