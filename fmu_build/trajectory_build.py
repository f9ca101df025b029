"""Builds the FMU of a trajectory, with its model description: references, breakpoints, accuracy."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from flexfmu.fmu_build.build import BuildProgress, BuiltFmu, build_from_sources
from flexfmu.fmu_build.choices import ChoiceParameter
from flexfmu.fmu_build.codegen import DESCRIPTION_FILE
from flexfmu.fmu_build.description import Description
from flexfmu.fmu_build.documentation import documentation_files
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.interface import Interface, Unknown, check_names, choice_variable, real_variable
from flexfmu.fmu_build.naming import Naming, named_variables
from flexfmu.fmu_build.picture import FINE_PEN, ICON_SIZE, PAGE_SIZE, PEN, Picture, curves_picture, png
from flexfmu.fmu_build.sources import Sources, assemble_sources
from flexfmu.fmu_build.templating import render
from flexfmu.fmu_build.trajectory_table import END_ORDER, KINDS, TrajectoryTable, tabulate
from flexfmu.model.symbolic import Variable
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
    progress: BuildProgress = lambda message: None,
) -> BuiltFmu:
    """Build an FMU 2.0 for co-simulation of a trajectory, shaped or not, unless an equal one is in the cache.

    The outputs are ``<axis>.reference.position``, ``.velocity`` and ``.acceleration`` with output derivatives up to order
    4, from polynomials between knots that reproduce the trajectory to `trajectory_table.TOLERANCE`. At a breakpoint they
    are the left limits, or the right limits if the parameter ``limit`` is ``right``. Time 0 of the trajectory is time 0 of
    the simulation.

    Args:
        trajectory: the trajectory.
        output: file to write; None leaves the FMU in the cache.
        axes: names of the trajectory's components.
        unit: unit of the positions.
        name: model name.
        stop_time, step: default experiment [s]; the default stop time is the duration of the trajectory.
        platforms, naming, cache, progress: as for `flexfmu.fmu_build.build.build_fmu`.

    Raises:
        BuildError: no table reproduces the trajectory, the number of axes is wrong, the unit is unknown, there is no
            compiler, compilation fails, or a file can't be written.
    """

    def make_sources() -> Sources:
        return generate_trajectory_sources(
            trajectory, experiment, axes=axes, unit=unit, name=name, naming=naming, progress=progress
        )

    # the default experiment lasts as long as the trajectory
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
    progress: BuildProgress = lambda message: None,
) -> Sources:
    """Generate all text files of the FMU; arguments as for `build_trajectory_fmu`.

    Raises:
        ModelError: no table reproduces the trajectory, the number of axes is wrong, or the unit is unknown.
    """
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

    # description, documentation and icon
    description = trajectory_description(motion).named(naming)
    pages = trajectory_documentation(motion, description, experiment)
    return assemble_sources("trajectory", description, experiment, code, pages, png(motion_picture(motion)))


LIMIT = ChoiceParameter(
    "limit",
    "What is shown at a breakpoint",
    {
        "left": (1, "left limits: the end of the piece that was run through"),
        "right": (2, "right limits: the next piece"),
    },
)

PICTURE_POINTS = 60
"""Number of points of each curve in the picture."""

_PER_TIME = ("", "/s", "/s2")


@dataclass(frozen=True)
class TableMotion:
    """A tabulated trajectory with its names.

    Attributes:
        name: model name.
        axes: names of the components.
        unit: unit of the positions.
        breakpoints: times at which derivatives may jump [s].
        table: table of knots.
    """

    name: str
    axes: tuple[str, ...]
    unit: str
    breakpoints: tuple[float, ...]
    table: TrajectoryTable

    @property
    def description(self) -> str:
        """One sentence for the model description."""
        return f"Position, velocity and acceleration of {', '.join(self.axes)} over {self.breakpoints[-1]!r} s."

    @property
    def outputs(self) -> tuple[Variable, ...]:
        """Output variables: positions of all axes, then velocities, then accelerations."""
        return tuple(
            Variable(
                name=f"{axis}.reference.{kind}",
                unit=self.unit + per_time,
                description=f"{kind.capitalize()} of {axis}",
                causality="output",
            )
            for kind, per_time in zip(KINDS, _PER_TIME, strict=True)
            for axis in self.axes
        )


def trajectory_description(motion: TableMotion) -> Description:
    """The content of a trajectory's model description.

    Raises:
        ModelError: two axes have the same name.
    """
    points = " ".join(map(repr, motion.breakpoints))
    return Description(
        name=motion.name,
        text=f"{motion.description} Output derivatives of orders 1 to {END_ORDER}; at breakpoints the limit that the "
        "parameter 'limit' chooses.",
        interface=trajectory_interface(motion),
        choices=(LIMIT,),
        max_output_order=END_ORDER,
        annotations={"Breakpoints": {"times": points}},
    )


def trajectory_interface(motion: TableMotion) -> Interface:
    """Number the outputs and the parameter ``limit``.

    No output is declared as the derivative of another: a trajectory has no continuous states that need it, Maestro 3.1.1
    fails if both are connected (ClassCastException in ComponentVariableFmi2Api.share), and libcosim rejects derivatives in
    the model structure that no variable declares.

    Raises:
        ModelError: a name is repeated.
    """
    names = [output.name for output in motion.outputs]
    check_names([*names, LIMIT.name])
    index_of = {name: index for index, name in enumerate(names, start=1)}
    # Reals, then the only Integer, with value reference 0
    reals = tuple(real_variable(output, index_of) for output in motion.outputs)
    limit = choice_variable(LIMIT, "left", len(reals) + 1, value_reference=0, variability="tunable")
    return Interface(
        variables=(*reals, limit),
        outputs=tuple(Unknown(variable.index, ()) for variable in reals),
        derivatives=(),
        initial_unknowns=tuple(Unknown(variable.index, (limit.index,)) for variable in reals),
    )


def motion_picture(motion: TableMotion, width: int = ICON_SIZE, height: int = ICON_SIZE, pen: float = PEN) -> Picture:
    """Picture of the positions of the first two axes over time."""
    knots, first = np.unique(motion.table.times, return_index=True)
    position = PchipInterpolator(knots, motion.table.jets[first, 0])
    times = np.linspace(knots[0], knots[-1], PICTURE_POINTS)
    curves = [list(zip(times.tolist(), values.tolist(), strict=True)) for values in position(times).T]
    return curves_picture(curves, width, height, pen)


def trajectory_documentation(
    motion: TableMotion, description: Description, experiment: DefaultExperiment
) -> dict[str, str]:
    """Files of the folder ``documentation/`` of a trajectory: path below the FMU's root → text."""
    return documentation_files(
        "trajectory.html.j2",
        description,
        experiment,
        picture=motion_picture(motion, *PAGE_SIZE, FINE_PEN),
        table=motion.table,
        breakpoints=motion.breakpoints,
        duration=motion.breakpoints[-1],
        errors=dict(zip(KINDS, motion.table.errors, strict=True)),
        max_order=END_ORDER,
    )
