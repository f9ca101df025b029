"""Sections of the scene file for filters: `[[filter]]` tables; `kind` determines their keys."""

from __future__ import annotations

import re
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from flexfmu.model.scene.imperfections import SignalSection
from flexfmu.model.scene.section import NotNegative, Positive, as_tuple, quantity

MODE = re.compile(r"(mode|resonance) ([1-9]\d*)")
"""Names of frequencies: of the robot with its motors locked, or free."""


def _mode(name: str) -> str:
    if MODE.fullmatch(name) is None:
        raise ValueError(f'name a frequency as "mode 1" (motors locked) or "resonance 1" (motors free), got {name!r}')
    return name


Hertz = Annotated[Positive, quantity("Hz")]
Coefficients = Annotated[tuple[float, ...], BeforeValidator(as_tuple), Field(min_length=1, max_length=3), quantity("1")]


class FilterSection(SignalSection):
    """A filter in series with a signal of both joints.

    Filters of torques act between controllers and imperfections, as of an amplifier; filters of measurements behind the
    imperfections, as of an encoder; filters of references on positions, velocities and accelerations alike. Several filters act one
    after the other.
    """

    signal: Literal["torque", "position", "velocity", "reference"] = "torque"


class TunedSection(FilterSection):
    """A filter with a frequency, or with that of a mode of the robot (`at`) at a `pose` of its path."""

    frequency: Hertz | None = None
    at: Annotated[str, AfterValidator(_mode)] | None = None
    pose: Literal["start", "middle", "end"] = "end"

    @model_validator(mode="after")
    def _one_frequency(self) -> Self:
        if (self.frequency is None) == (self.at is None):
            raise ValueError('give either `frequency` in Hz, or `at`, such as "mode 1"')
        return self


class NotchSection(TunedSection):
    """(s² + 2 depth damping w s + w²) / (s² + 2 damping w s + w²): the gain at w is `depth`, and 1 far from it."""

    kind: Literal["notch"]
    damping: Annotated[Positive, quantity("1")] = 0.5
    depth: Annotated[NotNegative, quantity("1")] = 0.0


class LowPassSection(TunedSection):
    """Butterworth low-pass of this order; its gain at the frequency is 1/√2."""

    kind: Literal["low-pass"]
    order: Annotated[int, quantity("1", ge=1, le=8)] = 2


class HighPassSection(TunedSection):
    """Butterworth high-pass of this order; its gain at the frequency is 1/√2."""

    kind: Literal["high-pass"]
    order: Annotated[int, quantity("1", ge=1, le=8)] = 2


class LeadLagSection(FilterSection):
    """(s / wz + 1) / (s / wp + 1): leads with a zero below the pole, lags with a pole below the zero."""

    kind: Literal["lead-lag"]
    zero: Hertz
    pole: Hertz


class BiquadSection(FilterSection):
    """A quotient of polynomials in s [rad/s], of order 2 at most, highest power first; exact at `prewarp`."""

    kind: Literal["biquad"]
    numerator: Coefficients
    denominator: Coefficients
    prewarp: Hertz | None = None

    @model_validator(mode="after")
    def _proper(self) -> Self:
        numerator, denominator = (
            len(each) - next((i for i, c in enumerate(each) if c), len(each))
            for each in (self.numerator, self.denominator)
        )
        if not denominator:
            raise ValueError("`denominator` must have a coefficient that isn't 0")
        if numerator > denominator:
            raise ValueError("the order of `numerator` must not exceed that of `denominator`")
        return self


FilterTable = Annotated[
    NotchSection | LowPassSection | HighPassSection | LeadLagSection | BiquadSection, Field(discriminator="kind")
]
