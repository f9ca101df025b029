"""The documentation folder of an FMU: one plain HTML page and the licence."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.interface import INITIAL_STATES, build_interface
from flexfmu.fmu_build.licences import licence_files
from flexfmu.fmu_build.templating import render

if TYPE_CHECKING:
    from flexfmu.model.symbolic import SymbolicModel


def documentation(model: SymbolicModel, experiment: DefaultExperiment) -> dict[str, str]:
    """Files of the folder ``documentation/``: path below the FMU's root → text."""
    page = render(
        "index.html.j2",
        model=model,
        experiment=experiment,
        initial_states=INITIAL_STATES,
        variables=build_interface(model).variables,
    )
    return {"documentation/index.html": page, **licence_files()}
