"""Sections of the scene file for disturbances: `[[disturbance]]` tables; `kind` determines their keys."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from flexfmu.model.scene.loop import Name, from_scene_file
from flexfmu.model.scene.section import NotNegative, Positive, Seconds, SecondsOrZero, Section, as_tuple, quantity

PAYLOAD = "payload.change"
"""Input of the robot for the mass that it picks up or drops [kg]."""

Signal = Literal["force.x", "force.y", "joint1.disturbance", "joint2.disturbance"]


class DisturbanceSection(Section):
    """A force at the end effector [N], or a torque on a motor, counter-clockwise [N.m], in a signal of the robot.

    It is zero before `start` and, with a `duration`, from `start` + `duration` on.
    """

    name: Name | None = None
    signal: Signal
    start: SecondsOrZero = 0.0
    duration: Annotated[Positive | None, quantity("s")] = None

    @property
    def begin(self) -> float:
        """First instant [s]."""
        return self.start


class StepSection(DisturbanceSection):
    """A step by `amplitude` at `start`; a pulse with a `duration`. Both instants are exact."""

    kind: Literal["step"]
    amplitude: float


class PulseSection(DisturbanceSection):
    """A pulse of height `amplitude` from `start` to `start` + `duration`. Both instants are exact."""

    kind: Literal["pulse"]
    amplitude: float
    duration: Seconds


class SampledDisturbanceSection(DisturbanceSection):
    """A disturbance that is held from sample to sample; the first sample is that of `start`.

    The default sample time is the communication step.
    """

    sample_time: Annotated[Positive | None, quantity("s")] = None


class SineSection(SampledDisturbanceSection):
    """A sine: `amplitude` sin(2 pi `frequency` (t - `start`) + `phase`)."""

    kind: Literal["sine"]
    amplitude: float
    frequency: Annotated[float, quantity("Hz", gt=0.0)]
    phase: Annotated[float, quantity("rad")] = 0.0


class BandNoiseSection(SampledDisturbanceSection):
    """Band-limited noise: sines with random phases, `components` of them with equal distances within `band`.

    The phases depend on `seed`, the section's name and the signal.
    """

    kind: Literal["noise"]
    standard_deviation: NotNegative
    band: Annotated[tuple[NotNegative, Positive], BeforeValidator(as_tuple), quantity("Hz")]
    components: Annotated[int, Field(ge=1, le=1000)] = 50
    seed: Annotated[int, Field(ge=0, lt=2**20)] = 0

    @model_validator(mode="after")
    def _band_ascends(self) -> Self:
        if self.band[0] >= self.band[1]:
            raise ValueError(f"`band` must ascend, [5.0, 50.0] for example, got {list(self.band)} Hz")
        return self


class CsvSection(SampledDisturbanceSection):
    """Values of a column of a CSV file with a column `time` in s, from `start` on; linear between the rows.

    `file` is relative to the scene file's folder. Before the first row and after the last one the disturbance is zero.
    """

    kind: Literal["csv"]
    file: Annotated[str, AfterValidator(from_scene_file)]
    column: str | None = None
    scale: float = 1.0


class PayloadChangeSection(Section):
    """A mass that the end effector picks up and drops, each at an exact instant; positions and velocities are continuous.

    A mass that is dropped without having been picked up is a part of `payload.mass`, by default all of it.
    """

    kind: Literal["payload"]
    name: Name | None = None
    mass: Annotated[Positive | None, quantity("kg")] = None
    picked_up: Annotated[NotNegative | None, quantity("s")] = None
    dropped: Annotated[NotNegative | None, quantity("s")] = None

    @property
    def begin(self) -> float:
        """First instant [s]."""
        return self.picked_up if self.picked_up is not None else self.dropped or 0.0

    @model_validator(mode="after")
    def _instants_fit(self) -> Self:
        if self.picked_up is None and self.dropped is None:
            raise ValueError("give `picked_up`, `dropped` or both, in s")
        if self.picked_up is not None and self.mass is None:
            raise ValueError("give the `mass` that is picked up, in kg")
        if self.picked_up is not None and self.dropped is not None and self.picked_up >= self.dropped:
            raise ValueError(f"`dropped` must be after `picked_up`, got {self.dropped:g} s and {self.picked_up:g} s")
        return self


DisturbanceKind = Annotated[
    StepSection | PulseSection | SineSection | BandNoiseSection | CsvSection | PayloadChangeSection,
    Field(discriminator="kind"),
]


def disturbance_inputs(sections: tuple[DisturbanceKind, ...]) -> tuple[str, ...]:
    """Names of the inputs that the robot has for these disturbances alone: torques on its motors, a change of its payload."""
    torques = ("joint1.disturbance", "joint2.disturbance")
    signals = {PAYLOAD if isinstance(each, PayloadChangeSection) else each.signal for each in sections}
    return (*(torques if signals & set(torques) else ()), *((PAYLOAD,) if PAYLOAD in signals else ()))
