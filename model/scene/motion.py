"""The section `trajectory`: the path, its blends, and the motion along it."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, model_validator

from flexfmu.model.scene.mechanism import Length
from flexfmu.model.scene.section import Seconds, SecondsOrZero, Section, as_tuple, named_kind, quantity

Point = Annotated[tuple[float, float], BeforeValidator(as_tuple), quantity("m")]
Direction = Annotated[tuple[float, float], BeforeValidator(as_tuple), quantity("1")]


class Blend(Section):
    """Rounding of the path's two corners: d = height along the lift, e = width along the crossing."""

    kind: Literal["lame", "clothoid", "polar"]
    height: Length
    width: Length


class Profile(Section):
    """Motion along the path; `ramp` is the fraction of the duration of each ramp of the trapezoidal velocity."""

    kind: Literal["poly7", "bang-bang", "trapezoidal"]
    ramp: Annotated[float, quantity("1", gt=0.0, le=0.5)] | None = None

    @model_validator(mode="after")
    def _ramp_belongs_to_trapezoidal(self) -> Self:
        if self.kind == "trapezoidal" and self.ramp is None:
            raise ValueError(
                "`ramp` is missing: profile `trapezoidal` needs 0 < ramp <= 0.5 (fraction of the duration)"
            )
        if self.kind != "trapezoidal" and self.ramp is not None:
            raise ValueError(
                f"`ramp` = {self.ramp} belongs to profile `trapezoidal` alone: remove it from `{self.kind}`"
            )
        return self


class TrajectorySection(Section):
    """The Adept half cycle: lift, crossing and lowering with blended corners, then a standstill of `dwell`."""

    start: Point
    lift: Direction
    height: Length
    width: Length
    blend: Blend
    profile: Annotated[Profile, BeforeValidator(named_kind)]
    duration: Seconds
    dwell: SecondsOrZero = 0.0

    @model_validator(mode="after")
    def _blends_fit(self) -> Self:
        if math.hypot(*self.lift) == 0.0:
            raise ValueError("`lift` must be a direction with a length above zero, got [0.0, 0.0]")
        if self.blend.height > self.height:
            raise ValueError(f"`blend.height` must be at most `height` = {self.height} m, got {self.blend.height} m")
        if self.blend.width > self.width / 2:
            raise ValueError(f"`blend.width` must be at most `width`/2 = {self.width / 2} m, got {self.blend.width} m")
        return self
