"""The options of a run, each said once: the functions that run scenes take them as keywords."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypedDict

from flexfmu.cosim.engine.results import Selection


class SceneOptions(TypedDict, total=False):
    """How a scene is prepared for its runs; what is left out, or None, is as the scene says."""

    communication_step: float | None
    """Communication step [s]."""
    tolerance: float | None
    """Relative tolerance of the FMU's integrator."""
    input_order: int | None
    """Degree of the input polynomials, 0 (values only) to 9. Default: the highest that the FMU supports."""
    fmu_path: Path | None
    """FMU of a scene with the same effects, instead of building one; its parameters are set from this scene."""
    initial: str | None
    """`static` or `undeformed`."""
    record: Selection | None
    """Which signals are recorded, how often, with how many derivatives."""
    isolate: bool | None
    """Simulate in a child process, so that a slave that crashes, exits or hangs ends only the run. Default: what the scene says, or
    where other tools' FMUs or Python slaves take part. Linux only. Python slaves passed as objects aren't isolated unless asked for:
    their changes would be lost in the child process."""
    call_limit: float | None
    """Time limit of one call of a slave in an isolated run [s]."""


class RunOptions(SceneOptions, total=False):
    """Options of one run: how the scene is prepared, and what is this run's own."""

    parameters: Mapping[str, float] | None
    """FMU parameters that differ from the scene's: {"payload.mass": 0.1}."""
    progress: Callable[[float], None] | None
    """Called repeatedly with the simulated fraction, 0 to 1."""
    accept_size: bool
    """Run however large the results are. Default: refuse more than 2 GB, companion included."""
