"""Sections of the scene file for input shapers: `[[shaper]]` tables."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from flexfmu.model.scene.loop import LoopSection, OwnPart
from flexfmu.model.scene.section import Positive, SecondsOrZero, Section, as_tuple, quantity


class Mode(Section):
    """A vibration mode: undamped natural frequency and damping ratio."""

    frequency: Annotated[float, quantity("Hz", gt=0.0)]
    ratio: Annotated[float, quantity("1", ge=0.0, lt=1.0)] = 0.0


def _modes(value: Any) -> Any:
    """The modes as a tuple; None for "along-path", which is the default."""
    if value is None or value == "along-path":
        return None
    if isinstance(value, (list, tuple)) and value:
        return tuple(value)
    raise ValueError(
        f'give "along-path" or a list of {{ frequency = 58.0, ratio = 0.1 }}, frequencies in Hz, got {value!r}'
    )


ShaperKind = Literal["zv", "zvd", "zvdd", "zvddd", "mzv", "ei", "2-hump-ei", "3-hump-ei", "um-zv"]


class AppliedShaperSection(LoopSection):
    """An input shaper for the joint references, for the motion along the path, or as a sampled slave.

    Shaping the motion along the path preserves the path. The sampled slave shapes the joint references.
    """

    apply: Literal["joints", "path", "sampled"] = "joints"
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


class ImpulseShaperSection(AppliedShaperSection):
    """An input shaper for vibration modes.

    By default `modes` are the lowest `mode_count` modes of the robot at the end of its path.
    """

    kind: ShaperKind
    modes: Annotated[tuple[Mode, ...] | None, BeforeValidator(_modes)] = None
    mode_count: Annotated[int, quantity("modes", ge=1, le=8)] = 1


class SpecifiedInsensitivitySection(AppliedShaperSection):
    """The shortest shaper whose residual vibration is at most `tolerance` within `band`, by optimisation."""

    kind: Literal["si"]
    band: Annotated[tuple[Positive, Positive], BeforeValidator(as_tuple), quantity("Hz")]
    tolerance: Annotated[float, quantity("1", gt=0.0, lt=1.0)] = 0.05
    ratio: Annotated[float, quantity("1", ge=0.0, lt=1.0)] = 0.0

    @model_validator(mode="after")
    def _lowest_comes_first(self) -> Self:
        if self.band[0] > self.band[1]:
            raise ValueError(f"`band` is lowest and highest frequency in Hz, got {list(self.band)}")
        return self


ShaperSection = Annotated[ImpulseShaperSection | SpecifiedInsensitivitySection | OwnPart, Field(discriminator="kind")]
