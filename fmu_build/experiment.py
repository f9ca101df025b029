"""The default experiment that an FMU proposes to its importer."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from flexfmu.fmu_build.errors import BuildError


@dataclass(frozen=True)
class DefaultExperiment:
    """Times and tolerance of the default experiment, which starts at 0 s.

    Attributes:
        stop_time: end [s].
        step: communication step [s].
        tolerance: relative tolerance of the integrator.

    Raises:
        BuildError: a value is not a positive number.
    """

    stop_time: float = 1.0
    step: float = 2e-4
    tolerance: float = 1e-6

    def __post_init__(self) -> None:
        for name, value, unit in (
            ("stop_time", self.stop_time, " s"),
            ("step", self.step, " s"),
            ("tolerance", self.tolerance, ""),
        ):
            if not (isfinite(value) and value > 0.0):
                raise BuildError(f"{name} of the default experiment must be a positive number, got {value}{unit}")
