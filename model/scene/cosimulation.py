"""The section `cosimulation`: drive, integration and coupling."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from flexfmu.model.scene.section import Seconds, SecondsOrZero, Section, as_tuple, named_kind, quantity

RelativeTolerance = Annotated[float, quantity("1", gt=0.0, le=0.1)]

LEAST_TOLERANCE = 1e-12
"""Smallest relative tolerance of the FMU: below it rounding errors determine the result."""


def _achievable(tolerance: float) -> float:
    if tolerance < LEAST_TOLERANCE:
        raise ValueError(
            f"must be at least {LEAST_TOLERANCE:g}, got {tolerance:g}: below, rounding errors decide and the result stays the same"
        )
    return tolerance


FmuTolerance = Annotated[float, quantity("1", le=0.1), AfterValidator(_achievable)]


class StepControl(Section):
    """Communication step control: keeps the coupling error of a run below `tolerance` times the signals' magnitudes.

    The first step is `step` of the section `cosimulation`.
    """

    tolerance: RelativeTolerance
    minimum: Seconds | None = None
    maximum: Seconds | None = None

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.minimum is not None and self.maximum is not None and self.minimum > self.maximum:
            raise ValueError(f"`minimum` must be at most `maximum` = {self.maximum} s, got {self.minimum} s")
        return self


class FixedPointSection(Section):
    """Fixed-point iteration on the signals of an algebraic loop; `relaxation` below 1 helps against divergence."""

    kind: Literal["fixed-point"]
    tolerance: RelativeTolerance = 1e-10
    iterations: Annotated[int, quantity("iterations", ge=1, le=100_000)] = 100
    relaxation: Annotated[float, quantity("1", gt=0.0, le=1.0)] = 1.0


class AndersonSection(Section):
    """Anderson acceleration: a quasi-Newton method that estimates the Jacobian from the last iterations."""

    kind: Literal["anderson"]
    tolerance: RelativeTolerance = 1e-10
    iterations: Annotated[int, quantity("iterations", ge=1, le=100_000)] = 50


LoopSolverSection = Annotated[
    FixedPointSection | AndersonSection, Field(discriminator="kind"), BeforeValidator(named_kind)
]


def _step(value: object) -> object:
    if isinstance(value, str) and value != "auto":
        raise ValueError(f'must be a time above 0 s, or "auto" for steps chosen from the motion, got {value!r}')
    return None if value == "auto" else value


RECORD_STEP = 1e-3
"""Default interval of the recorded instants where the run chooses its communication steps [s]."""


class Cosimulation(Section):
    """Drive, integration and coupling of a run.

    `step` is the communication step; left out, or "auto", the steps are chosen from the motion, which alone drives the
    robot then. `record_step` is the interval of the recorded instants (default: every communication point, 1 ms with chosen
    steps), `record` the recorded signals (default: all), `record_order` the number of their derivatives.

    `integrator` is the FMU's method, `integrator_step` its fixed step; with 0 the steps follow from `tolerance`.
    `algorithm` couples the slaves over a communication step. `loop_solver` solves algebraic loops, which are errors
    without one, and the implicit coupling. `isolate` runs the slaves in a child process; by default only where code of
    other tools or users takes part. `call_limit` is the longest time in one call of an isolated slave.
    """

    drive: Literal["motion", "torque"] = "motion"
    step: Annotated[Seconds | None, BeforeValidator(_step)] = None
    record_step: Seconds | None = None
    record: Annotated[tuple[str, ...] | None, BeforeValidator(as_tuple)] = None
    record_order: Annotated[int, quantity("derivatives", ge=0, le=2)] = 2
    tolerance: FmuTolerance
    initial: Literal["static", "undeformed"] = "static"
    integrator: Literal["automatic", "gauss2", "gauss3", "gauss4", "radau3", "dopri5", "rk4", "radau3-dense"] = (
        "automatic"
    )
    integrator_step: SecondsOrZero = 0.0
    settling_band: Annotated[float, quantity("m", gt=0.0)] = 1e-5
    algorithm: Literal["gauss-seidel", "jacobi", "implicit"] = "gauss-seidel"
    step_control: StepControl | None = None
    loop_solver: LoopSolverSection | None = None
    isolate: bool | None = None
    call_limit: Seconds = 60.0

    @model_validator(mode="after")
    def _step_where_needed(self) -> Self:
        if self.step is None and (self.drive == "torque" or self.step_control is not None):
            where = 'drive = "torque"' if self.drive == "torque" else "step_control"
            raise ValueError(f"`step` is missing: with {where} it is needed, 1e-3 s for example")
        return self

    @property
    def communication_step(self) -> float:
        """The communication step [s]; where the run chooses its steps, the interval of the recorded instants."""
        return self.step or self.record_step or RECORD_STEP
