"""Gain schedules of controllers: factors on gains over a signal, `schedule = { over = "joint1.position", at = [..], proportional = [..] }`."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import BeforeValidator, model_validator

from flexfmu.model.scene.section import NotNegativePerJoint, Section, as_tuple, quantity

Breakpoints = Annotated[tuple[float, ...], BeforeValidator(as_tuple)]
Factors = Annotated[tuple[NotNegativePerJoint, ...], BeforeValidator(as_tuple)]
"""One factor, or a pair for both joints, for each breakpoint."""
FactorTable = Annotated[Factors | None, quantity("1")]


class ScheduleSection(Section):
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
