"""Sections of the scene file about the robot's parts: links, material, mechanism and payload."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import model_validator

from flexfmu.model.scene.section import NOT_TINY, Section, quantity

Length = Annotated[float, quantity("m", gt=0.0)]
LinkLength = Annotated[float, quantity("m", gt=0.0, le=1e3), NOT_TINY]


class LinkSection(Section):
    """A round rod; `inner_diameter` makes it a tube."""

    length: LinkLength
    diameter: Annotated[float, quantity("m", gt=0.0, le=1e2), NOT_TINY]
    inner_diameter: Annotated[float, quantity("m", ge=0.0, le=1e2)] = 0.0

    @model_validator(mode="after")
    def _tube_has_a_wall(self) -> Self:
        if self.inner_diameter >= self.diameter:
            raise ValueError(
                f"`inner_diameter` must be below `diameter` = {self.diameter} m, got {self.inner_diameter} m"
            )
        return self


class Material(Section):
    """Linear elastic material of all links."""

    density: Annotated[float, quantity("kg/m3", gt=0.0, le=1e6), NOT_TINY]
    youngs_modulus: Annotated[float, quantity("Pa", gt=0.0, le=1e15), NOT_TINY]
    poissons_ratio: Annotated[float, quantity("1", ge=-0.99, le=0.5)] = 0.33
    yield_strength: Annotated[float | None, quantity("Pa", gt=0.0)] = None

    @model_validator(mode="after")
    def _yields_before_it_doubles_its_length(self) -> Self:
        if self.yield_strength is not None and self.yield_strength >= self.youngs_modulus:
            raise ValueError(
                f"`yield_strength` must be below `youngs_modulus` = {self.youngs_modulus:g} Pa, got {self.yield_strength:g} Pa: "
                f"metals yield at 1e8 to 1e9 Pa"
            )
        return self


class Mechanism(Section):
    """The five-bar mechanism: leg 1 has its base at (-base_half_distance, 0), leg 2 at (+base_half_distance, 0)."""

    base_half_distance: LinkLength
    working_mode: Literal["elbows-out", "elbows-in", "left", "right"]
    assembly_mode: Literal["left", "right"]
    proximal: LinkSection
    distal: LinkSection
    material: Material


class Payload(Section):
    """Point mass at the end effector, and rotary inertia that rotates with link 12; zero leaves each out."""

    mass: Annotated[float, quantity("kg", ge=0.0, le=1e6)]
    inertia: Annotated[float, quantity("kg.m2", ge=0.0, le=1e6)] = 0.0
