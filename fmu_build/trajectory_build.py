"""From a trajectory to an FMU file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from flexfmu.fmu_build.build import BuiltFmu, Progress, build_from_sources
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.icon import png
from flexfmu.fmu_build.naming import named_variables
from flexfmu.fmu_build.templating import render
from flexfmu.fmu_build.trajectory_table import tabulate

if TYPE_CHECKING:
    from flexfmu.fmu_build.naming import Naming
    from flexfmu.fmu_build.sources import Sources
    from flexfmu.trajectories.trajectory import Trajectory

DEFAULT_STEP = 1e-3
"""Communication step of the default experiment [s]."""


def build_trajectory_fmu(
    trajectory: Trajectory,
    output: Path | None = None,
    *,
    axes: Sequence[str] = ("joint1", "joint2"),
    unit: str = "rad",
    name: str = "trajectory",
    stop_time: float | None = None,
    step: float = DEFAULT_STEP,
    platforms: Iterable[str] | None = None,
    naming: Naming = "structured",
    cache: bool = True,
    progress: Progress = lambda message: None,
) -> BuiltFmu:
    """Build an FMU 2.0 for co-simulation of a trajectory, shaped or not, unless an equal one is in the cache.

    Its outputs are ``<axis>.reference.position``, ``.velocity`` and ``.acceleration`` with their derivatives up to order 4,
    from polynomials between knots that reproduce the trajectory to `trajectory_table.TOLERANCE`. After a step that ends
    on a breakpoint it shows the left limits, unless the parameter ``limit`` says ``right``. Time 0 of the trajectory is
    time 0 of the simulation.

    Args:
        trajectory: what to export.
        output: file to write; None leaves the FMU in the cache.
        axes: names of the trajectory's components.
        unit: unit of the positions.
        name: model name.
        stop_time, step: default experiment [s]; the duration of the motion if there is no stop time.
        platforms, naming, cache, progress: as for `flexfmu.fmu_build.build.build_fmu`.

    Raises:
        BuildError: in one line what is wrong and what to do: a trajectory that no table reproduces, axes that don't suit
            it, no compiler, a compiler's error, or a file that cannot be written.
    """

    def make_sources() -> Sources:
        return generate_trajectory_sources(
            trajectory, experiment, axes=axes, unit=unit, name=name, naming=naming, progress=progress
        )

    end = float(f"{trajectory.duration:.12g}") if stop_time is None else stop_time
    experiment = DefaultExperiment(stop_time=end, step=step)
    return build_from_sources(
        make_sources, experiment, output=output, platforms=platforms, cache=cache, progress=progress
    )


def generate_trajectory_sources(
    trajectory: Trajectory,
    experiment: DefaultExperiment,
    *,
    axes: Sequence[str] = ("joint1", "joint2"),
    unit: str = "rad",
    name: str = "trajectory",
    naming: Naming = "structured",
    progress: Progress = lambda message: None,
) -> Sources:
    """Everything of the FMU that is text.

    Raises:
        ModelError: no table reproduces the trajectory, or the axes don't suit it.
    """
    from flexfmu.fmu_build.codegen import DESCRIPTION_FILE
    from flexfmu.fmu_build.sources import assemble_sources
    from flexfmu.fmu_build.trajectory_description import (
        TableMotion,
        motion_picture,
        trajectory_description,
        trajectory_documentation,
    )

    progress("placing knots")
    table = tabulate(trajectory)
    if table.jets.shape[2] != len(axes):
        raise ModelError(f"the trajectory has {table.jets.shape[2]} components, got the axes {', '.join(axes)}")
    motion = TableMotion(name, tuple(axes), unit, tuple(map(float, trajectory.breakpoints)), table)

    def code(guid: str) -> dict[str, str]:
        template = "trajectory_description.c.j2"
        return {
            DESCRIPTION_FILE: render(
                template,
                name=name,
                guid=guid,
                table=table,
                axes=motion.axes,
                outputs=named_variables(motion.outputs, naming),
            )
        }

    description = trajectory_description(motion).named(naming)
    pages = trajectory_documentation(motion, description, experiment)
    return assemble_sources("trajectory", description, experiment, code, pages, png(motion_picture(motion)))
