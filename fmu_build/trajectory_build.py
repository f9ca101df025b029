"""The FMU of a planned motion: references from a table of knots, breakpoints, accuracy.

The outputs are ``<axis>.reference.position``, ``.velocity`` and ``.acceleration`` with output derivatives up to order 4, from
polynomials between knots that reproduce the trajectory to `trajectory_table.TOLERANCE`. At a breakpoint they are the left limits, or
the right limits if the parameter ``limit`` is ``right``. Time 0 of the trajectory is time 0 of the simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexfmu.fmu_build.choices import ChoiceParameter
from flexfmu.fmu_build.description import Content, Description
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.interface import Interface, choice_variable, real_variables
from flexfmu.fmu_build.naming import Naming, named_variables
from flexfmu.fmu_build.picture import curves_picture
from flexfmu.fmu_build.templating import render
from flexfmu.fmu_build.trajectory_table import END_ORDER, KINDS, tabulate
from flexfmu.model.symbolic import Variable
from flexfmu.trajectories.trajectory import Trajectory

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


@dataclass(frozen=True)
class Motion:
    """A trajectory, shaped or not, with the names of an FMU.

    Attributes:
        trajectory: the trajectory.
        axes: names of its components.
        unit: unit of the positions.
        name: model name.
    """

    trajectory: Trajectory
    axes: Sequence[str] = ("joint1", "joint2")
    unit: str = "rad"
    name: str = "trajectory"


def motion_content(motion: Motion, naming: Naming) -> Content:
    """What a motion's FMU has of its own.

    No output is declared as the derivative of another: a trajectory has no continuous states that need it, Maestro 3.1.1
    fails if both are connected (ClassCastException in ComponentVariableFmi2Api.share), and libcosim rejects derivatives in
    the model structure that no variable declares.

    Raises:
        ModelError: no table reproduces the trajectory, the number of axes is wrong, or the unit is unknown.
    """
    table, axes, name = tabulate(motion.trajectory), tuple(motion.axes), motion.name
    if table.jets.shape[2] != len(axes):
        raise ModelError(f"the trajectory has {table.jets.shape[2]} components, got the axes {', '.join(axes)}")
    breakpoints = tuple(map(float, motion.trajectory.breakpoints))
    # positions of all axes, then velocities, then accelerations
    outputs = tuple(
        Variable(f"{axis}.reference.{kind}", motion.unit + per_time, f"{kind.capitalize()} of {axis}", "output")
        for kind, per_time in zip(KINDS, ("", "/s", "/s2"), strict=True)
        for axis in axes
    )
    shown = tuple(output.name for output in outputs)
    limit = choice_variable(LIMIT, "left", value_reference=0, variability="tunable")
    description = Description(
        name=name,
        text=f"Position, velocity and acceleration of {', '.join(axes)} over {breakpoints[-1]!r} s. Output derivatives of "
        f"orders 1 to {END_ORDER}; at breakpoints the limit that the parameter 'limit' chooses.",
        interface=Interface((*real_variables(outputs), limit), dict.fromkeys(shown, ()), shown, (LIMIT.name,)),
        choices=(LIMIT,),
        max_output_order=END_ORDER,
        annotations={"Breakpoints": {"times": " ".join(map(repr, breakpoints))}},
    )
    values = {"name": name, "table": table, "axes": axes, "outputs": named_variables(outputs, naming)}
    # a picture of the positions of the first two axes over time
    times = np.linspace(breakpoints[0], breakpoints[-1], PICTURE_POINTS)
    positions = motion.trajectory.evaluate(times, 0)[0]
    curves = [list(zip(times.tolist(), values.tolist(), strict=True)) for values in positions.T]
    return Content(
        "trajectory",
        description,
        {},
        lambda guid: render("trajectory_description.c.j2", guid=guid, **values),
        "trajectory.html.j2",
        picture=curves_picture(curves),
        values={
            "table": table,
            "breakpoints": breakpoints,
            "duration": breakpoints[-1],
            "errors": dict(zip(KINDS, table.errors, strict=True)),
            "max_order": END_ORDER,
        },
    )
