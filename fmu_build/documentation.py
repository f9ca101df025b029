"""What the documentation of a plant shows besides its variables: picture, effects, equations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexfmu.fmu_build.choices import INITIAL
from flexfmu.fmu_build.description import Description
from flexfmu.fmu_build.documentation_files import documentation_files
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.icon import ICON_SIZE
from flexfmu.fmu_build.integrators import INTEGRATOR, LEAST_TOLERANCE
from flexfmu.fmu_build.picture import Picture, block_picture, mechanism_picture

if TYPE_CHECKING:
    from flexfmu.model.symbolic import SymbolicModel

PICTURE_SIZE = (560, 420)
"""Width and height of the page's picture [px]."""


def documentation(model: SymbolicModel, description: Description, experiment: DefaultExperiment) -> dict[str, str]:
    """Files of the folder ``documentation/``: path below the FMU's root → text."""
    return documentation_files(
        "index.html.j2",
        description,
        experiment,
        picture=plant_picture(model, *PICTURE_SIZE, labelled=True),
        model=model,
        states=_states(model),
        initial_states=INITIAL.items,
        integrators=INTEGRATOR.items,
        least_tolerance=LEAST_TOLERANCE,
    )


def _states(model: SymbolicModel) -> list[str]:
    """Names of the coordinates, each with its rate."""
    rates = {output.derivative_of: output.name for output in model.outputs}
    return [name for unknown in model.unknowns for name in (unknown, rates[unknown])]


def plant_picture(
    model: SymbolicModel, width: int = ICON_SIZE, height: int = ICON_SIZE, *, labelled: bool = False
) -> Picture:
    """The mechanism in its start pose; a plain block where there is no mechanism to draw."""
    if model.drawing is None:
        return block_picture(width, height)
    return mechanism_picture(model.drawing, width, height, labelled)
