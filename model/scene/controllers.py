"""Sections of the scene file for controllers: `[[controller]]` tables; `kind` determines their keys.

A gain schedule is a table of factors on gains over a signal, `schedule = { over = "joint1.position", at = [..], proportional = [..] }`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, ValidationInfo, model_validator

from flexfmu.model.scene import section
from flexfmu.model.scene.loop import OwnPart, SampledSection, Sampling, from_scene_file

Matrix = Annotated[tuple[tuple[float, ...], ...], BeforeValidator(section.tuples)]
SignalNames = Annotated[tuple[str, ...], BeforeValidator(section.as_tuple)]
TorqueLimit = Annotated[section.PositivePerJoint | None, section.quantity("N.m")]


Breakpoints = Annotated[tuple[float, ...], BeforeValidator(section.as_tuple)]
Factors = Annotated[tuple[section.NotNegativePerJoint, ...], BeforeValidator(section.as_tuple)]
"""One factor, or a pair for both joints, for each breakpoint."""
FactorTable = Annotated[Factors | None, section.quantity("1")]


Correction = Annotated[tuple[tuple[float, float], ...], BeforeValidator(section.tuples)]
"""Torques of both joints for each sample."""


class ScheduleSection(section.Section):
    """Factors on gains at the breakpoints `at` of the signal `over`, linear in between and constant beyond.

    `over` is any signal, such as "joint1.reference.position" or "end_effector.position.x", or "payload.mass", the payload that the
    scene has or that a slave outputs.
    """

    over: str
    at: Breakpoints

    @property
    def factors(self) -> dict[str, tuple[tuple[float, float], ...]]:
        """Key of a gain → factors of both joints at each breakpoint."""
        tables = {key: getattr(self, key) for key in type(self).model_fields if key not in ("over", "at")}
        return {key: table for key, table in tables.items() if table is not None}

    @model_validator(mode="after")
    def _tables_fit(self) -> Self:
        if len(self.at) < 2 or any(a >= b for a, b in zip(self.at[:-1], self.at[1:], strict=True)):
            raise ValueError(f"`at` must be two or more ascending values of {self.over}, got {list(self.at)}")
        if not self.factors:
            gains = ", ".join(key for key in type(self).model_fields if key not in ("over", "at"))
            raise ValueError(f"the schedule has no table: give one factor at each of `at` for {gains}")
        for key, table in self.factors.items():
            if len(table) != len(self.at):
                raise ValueError(f"`{key}` must have one factor at each of `at`, {len(self.at)}, got {len(table)}")
        return self


class PdScheduleSection(ScheduleSection):
    """Factors on the gains of a PD controller."""

    proportional: FactorTable = None
    derivative: FactorTable = None


class PidScheduleSection(PdScheduleSection):
    """Factors on the gains of a PID controller."""

    integral: FactorTable = None


class PositionScheduleSection(ScheduleSection):
    """Factors on the gains of a position loop."""

    proportional: FactorTable = None
    velocity_feedforward: FactorTable = None


class VelocityScheduleSection(ScheduleSection):
    """Factors on the gains of a velocity loop."""

    proportional: FactorTable = None
    integral: FactorTable = None
    inertia: FactorTable = None


class PdSection(SampledSection):
    """Torque = proportional * position error + derivative * velocity error."""

    kind: Literal["pd"]
    proportional: Annotated[section.NotNegativePerJoint, section.quantity("N.m/rad")]
    derivative: Annotated[section.NotNegativePerJoint, section.quantity("N.m.s/rad")]
    torque_limit: TorqueLimit = None
    schedule: PdScheduleSection | None = None


class ClampingSection(section.Section):
    """Conditional integration: the integrator stops while it would drive the torque further into saturation."""

    kind: Literal["clamping"] = "clamping"


class BackCalculationSection(section.Section):
    """Back-calculation: the saturation error is fed back to the integrator with the time constant `tracking_time`."""

    kind: Literal["back-calculation"]
    tracking_time: section.SecondsOrZero


class UnprotectedSection(section.Section):
    """No anti-windup: the integrator winds up."""

    kind: Literal["none"]


AntiWindupSection = Annotated[
    ClampingSection | BackCalculationSection | UnprotectedSection,
    BeforeValidator(section.named_kind),
    Field(discriminator="kind"),
]


class PidSection(SampledSection):
    """PID control of the measured angles.

    `setpoint_weight` acts on changes of the reference since the start. `initial_torque` is the torque there, from the integral; by default
    what holds the robot, and nothing if a feedforward does or without an integral. `anti_windup` is the method at the torque limit: "clamping", "none" or
    `{ kind = "back-calculation", tracking_time = 0.01 }`.
    """

    kind: Literal["pid"]
    proportional: Annotated[section.NotNegativePerJoint, section.quantity("N.m/rad")]
    integral: Annotated[section.NotNegativePerJoint, section.quantity("N.m/(rad.s)")]
    derivative: Annotated[section.NotNegativePerJoint, section.quantity("N.m.s/rad")]
    filter_time: Annotated[section.NotNegativePerJoint, section.quantity("s")] = (0.0, 0.0)
    setpoint_weight: float = 1.0
    derivative_weight: float = 1.0
    initial_torque: Annotated[section.PerJoint | None, section.quantity("N.m")] = None
    torque_limit: TorqueLimit = None
    anti_windup: AntiWindupSection = ClampingSection()
    schedule: PidScheduleSection | None = None


class LoopOfCascade(section.Section):
    """Sample time and offset of a loop of the cascade, by default those of the controller."""

    sample_time: Annotated[section.Positive | None, section.quantity("s")] = None
    offset: Annotated[section.NotNegative | None, section.quantity("s")] = None


class PositionLoopSection(LoopOfCascade):
    """Velocity command = proportional * position error + velocity_feedforward * reference velocity, within ± velocity_limit."""

    proportional: Annotated[section.NotNegativePerJoint, section.quantity("1/s")]
    velocity_feedforward: Annotated[section.NotNegativePerJoint, section.quantity("1")] = (1.0, 1.0)
    velocity_limit: Annotated[section.PositivePerJoint | None, section.quantity("rad/s")] = None
    schedule: PositionScheduleSection | None = None


class VelocityLoopSection(LoopOfCascade):
    """Torque command = proportional * velocity error + its integral * integral + inertia * reference acceleration."""

    proportional: Annotated[section.NotNegativePerJoint, section.quantity("N.m.s/rad")]
    integral: Annotated[section.NotNegativePerJoint, section.quantity("N.m/rad")] = (0.0, 0.0)
    inertia: Annotated[section.NotNegativePerJoint, section.quantity("kg.m2")] = (0.0, 0.0)
    initial_torque: Annotated[section.PerJoint, section.quantity("N.m")] = (0.0, 0.0)
    schedule: VelocityScheduleSection | None = None


class CurrentLoopSection(LoopOfCascade):
    """The torque follows its command as a first-order lag, sampled; zero is a delay of one sample."""

    time_constant: Annotated[section.NotNegativePerJoint, section.quantity("s")]


class CascadeSection(SampledSection):
    """The cascade of an industrial drive: position P, velocity PI, current loop.

    Each loop has its own sample time and offset, by default those of the controller. Without `current` the torque is its
    command. `torque_limit` holds for the command of the velocity loop, whose integral `anti_windup` protects, and in the current loop.
    """

    kind: Literal["cascade"]
    position: PositionLoopSection
    velocity: VelocityLoopSection
    current: CurrentLoopSection | None = None
    torque_limit: TorqueLimit = None
    anti_windup: AntiWindupSection = ClampingSection()

    def sampling_of(self, loop: LoopOfCascade) -> Sampling:
        """Sample time and offset [s] of a loop."""
        return Sampling(
            sample_time=loop.sample_time or self.sample_time, offset=self.offset if loop.offset is None else loop.offset
        )


class ComputedTorqueSection(SampledSection):
    """Computed torque: rigid inverse dynamics for the reference acceleration with PD correction.

    `payload` is the mass that the controller assumes, by default that of the scene.
    """

    kind: Literal["computed-torque"]
    proportional: Annotated[section.NotNegativePerJoint, section.quantity("1/s2")]
    derivative: Annotated[section.NotNegativePerJoint, section.quantity("1/s")]
    payload: Annotated[section.NotNegative | None, section.quantity("kg")] = None
    torque_limit: TorqueLimit = None


class FeedforwardSection(SampledSection):
    """Inverse dynamics of the reference motion, added to the torque of another controller; `payload` as above.

    `robot` = "flexible" gives the torques with which the motors of the flexible robot follow their references, from a simulation
    of the known motion; "rigid" those of the rigid robot, from the references of the moment. `correction` is added to the former,
    sample by sample; the last one holds on.
    """

    kind: Literal["feedforward"]
    robot: Literal["rigid", "flexible"] = "rigid"
    correction: Annotated[Correction, section.quantity("N.m")] = ()
    payload: Annotated[section.NotNegative | None, section.quantity("kg")] = None

    @model_validator(mode="after")
    def _correction_has_a_motion(self) -> Self:
        if self.correction and self.robot == "rigid":
            raise ValueError('`correction` belongs to `robot = "flexible"`, whose torques are those of a known motion')
        return self


class FrictionCompensationSection(SampledSection):
    """Torque against the motors' friction, added to the torque of another controller, from the reference's or the measured velocity.

    Its law is that of smooth friction, viscous w + coulomb w / sqrt(w² + velocity²). Coefficients that are left out are the scene's.
    """

    kind: Literal["friction-compensation"]
    viscous: Annotated[section.NotNegativePerJoint | None, section.quantity("N.m.s/rad")] = None
    coulomb: Annotated[section.NotNegativePerJoint | None, section.quantity("N.m")] = None
    velocity: Annotated[section.Positive | None, section.quantity("rad/s")] = None
    motion: Literal["reference", "measured"] = "reference"


class GravityFeedforwardSection(SampledSection):
    """Torques that hold the rigid robot at rest in its pose, added to the torque of another controller; `payload` as above."""

    kind: Literal["gravity-feedforward"]
    motion: Literal["reference", "measured"] = "reference"
    payload: Annotated[section.NotNegative | None, section.quantity("kg")] = None


class DisturbanceObserverSection(SampledSection):
    """Torque against the disturbance that explains the motion, added to the torque of another controller.

    The model is the rigid robot with `payload`, or with `inertia` one inertia for each joint alone. `time_constant` is that of the
    filter, `torque_limit` the largest torque that is added.
    """

    kind: Literal["disturbance-observer"]
    time_constant: Annotated[section.NotNegativePerJoint, section.quantity("s")]
    inertia: Annotated[section.PositivePerJoint | None, section.quantity("kg.m2")] = None
    payload: Annotated[section.NotNegative | None, section.quantity("kg")] = None
    torque_limit: TorqueLimit = None


Responses = tuple[tuple[tuple[tuple[float, ...], ...], ...], ...]


def _cut_off(value: Any) -> Any:
    """A cut-off, or a word for one."""
    if value in ("auto", "none", None) or (
        isinstance(value, (int, float)) and not isinstance(value, bool) and value > 0.0
    ):
        return value
    raise ValueError(f'give a cut-off above 0 Hz, "auto" or "none", got {value!r}')


class LearningSection(SampledSection):
    """Iterative learning control, added to the torque of another controller.

    The robot makes the motion there and back `cycles` times. With `law` = "proportional" the learned torque grows after each cycle by
    `gain` times the position error `lead` samples later; with "norm-optimal" by what a model of the loop says of all errors.

    `forgetting` is the share of the learned torque that each cycle loses. The dwell between two motions is that of the
    scene, extended so that a cycle is a whole number of samples. `q_filter` is the cut-off of a low-pass without phase through which
    what is learned goes; "auto", which norm-optimal learning has by default, chooses it so that learning converges with all payloads
    within `payload_error` of the robot's.

    The norm-optimal law minimises squared errors and changes of the torque, weighted by `regularisation`. Its model is the loop at nine
    poses with the scene's payload or `payload`, or `response`: angles of the joints, samples after a torque of 1 N.m of one sample.
    """

    kind: Literal["learning"]
    law: Literal["proportional", "norm-optimal"] = "proportional"
    gain: Annotated[section.NotNegativePerJoint | None, section.quantity("N.m/rad")] = None
    cycles: Annotated[int, section.quantity("cycles", ge=1, le=1000)]
    lead: Annotated[int, section.quantity("samples", ge=0)] = 1
    forgetting: Annotated[float, section.quantity("1", ge=0.0, lt=1.0)] = 0.0
    q_filter: Annotated[float | Literal["auto", "none"] | None, BeforeValidator(_cut_off), section.quantity("Hz")] = (
        None
    )
    payload_error: Annotated[float, section.quantity("1", ge=0.0, lt=1.0)] = 0.2
    regularisation: Annotated[float, section.quantity("1", gt=0.0)] = 1e-3
    payload: Annotated[section.NotNegative | None, section.quantity("kg")] = None
    response: Annotated[Responses | None, BeforeValidator(section.tuples), section.quantity("rad/(N.m)")] = None

    @model_validator(mode="after")
    def _keys_fit_the_law(self) -> Self:
        keys = {"proportional": ("gain", "lead"), "norm-optimal": ("regularisation", "payload", "response")}
        other = "norm-optimal" if self.law == "proportional" else "proportional"
        for key in keys[other]:
            if getattr(self, key) != type(self).model_fields[key].default:
                raise ValueError(f'`{key}` goes with `law = "{other}"`, not with "{self.law}": leave it out')
        if self.law == "proportional" and self.gain is None:
            raise ValueError('the key `gain` in N.m/rad is missing; only `law = "norm-optimal"` needs none')
        return self

    @property
    def cut_off(self) -> float | Literal["auto"] | None:
        """Cut-off of the Q-filter [Hz], ``auto`` where it is to be chosen, None for none."""
        if self.q_filter is None:
            return "auto" if self.law == "norm-optimal" else None
        return None if self.q_filter == "none" else self.q_filter


class StateFeedbackSection(SampledSection):
    """Linear-quadratic regulator with a Kalman filter, designed for the robot linearised at `pose`.

    The cost is the mean of (position error / position_error)² + (velocity error / velocity_error)² + (torque deviation
    / torque_deviation)² over both joints. `torque_noise` and `measurement_noise` are the standard deviations that the
    filter assumes.
    """

    kind: Literal["state-feedback"]
    pose: Literal["start", "middle", "end"] = "end"
    position_error: Annotated[section.PositivePerJoint, section.quantity("rad")] = (1e-3, 1e-3)
    velocity_error: Annotated[section.PositivePerJoint, section.quantity("rad/s")] = (0.1, 0.1)
    torque_deviation: Annotated[section.PositivePerJoint, section.quantity("N.m")] = (10.0, 10.0)
    torque_noise: Annotated[section.Positive, section.quantity("N.m")] = 1.0
    measurement_noise: Annotated[section.Positive, section.quantity("rad")] = 1e-5
    torque_limit: TorqueLimit = None


class HInfinitySection(SampledSection):
    """H-infinity loop shaping for the robot linearised at `pose`, from measured angles alone.

    The weight of each joint is k (1 + 1 / (integral_time s)), with the k for which the joint's own loop crosses 1 at `bandwidth`. The
    integral time is 5 / (2 pi bandwidth) by default.
    """

    kind: Literal["h-infinity"]
    pose: Literal["start", "middle", "end"] = "end"
    bandwidth: Annotated[section.PositivePerJoint, section.quantity("Hz")]
    integral_time: Annotated[section.PositivePerJoint | None, section.quantity("s")] = None
    torque_limit: TorqueLimit = None


class StateSpaceSection(SampledSection):
    """x_k+1 = A x_k + B u_k, y_k = C x_k + D u_k; the signals are named like those of the robot."""

    kind: Literal["state-space"]
    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix | None = None
    inputs: SignalNames
    outputs: SignalNames


def _files(value: Any, info: ValidationInfo) -> Any:
    """One path or several as a tuple, each from the scene file's folder."""
    paths = [value] if isinstance(value, str) else value
    texts = isinstance(paths, (list, tuple)) and paths and all(isinstance(each, str) for each in paths)
    if not texts:
        raise ValueError(f"give the path of a C file, or a list of C files and headers, got {value!r}")
    return tuple(from_scene_file(each, info) for each in paths)


class CFunctionSection(SampledSection):
    """A function in C that calculates outputs and next states; its signature stands in docs/control-loop.md.

    `source` is the C file, or a list of C files and headers, relative to the scene file's folder. `units` gives the unit of
    signals and parameters where it isn't that of the robot's signal of this name.
    """

    kind: Literal["c-function"]
    source: Annotated[str | tuple[str, ...], BeforeValidator(_files)]
    function: str = ""
    inputs: SignalNames
    outputs: SignalNames
    parameters: dict[str, float] = Field(default_factory=dict)
    states: Annotated[tuple[float, ...], BeforeValidator(section.as_tuple)] = ()
    units: dict[str, str] = Field(default_factory=dict)


ControllerSection = Annotated[
    PdSection
    | PidSection
    | CascadeSection
    | ComputedTorqueSection
    | FeedforwardSection
    | FrictionCompensationSection
    | GravityFeedforwardSection
    | DisturbanceObserverSection
    | LearningSection
    | StateFeedbackSection
    | HInfinitySection
    | StateSpaceSection
    | CFunctionSection
    | OwnPart,
    Field(discriminator="kind"),
]
