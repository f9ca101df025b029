"""The model description (modelDescription.xml) of an FMI 2.0 co-simulation FMU."""

from __future__ import annotations

from importlib.metadata import version
from typing import TYPE_CHECKING

from flexfmu.fmu_build.codegen import MAX_INPUT_ORDER, identifier
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.interface import INITIAL_STATES, build_interface
from flexfmu.fmu_build.templating import render
from flexfmu.fmu_build.units import unit_definitions

if TYPE_CHECKING:
    from flexfmu.model.symbolic import SymbolicModel

MAX_OUTPUT_DERIVATIVE_ORDER = 2
"""The runtime differentiates its outputs exactly up to this order."""

LOG_CATEGORIES = {
    "logStatusWarning": "What went on with a reservation",
    "logStatusDiscard": "Steps that could not be made; a smaller one may work",
    "logStatusError": "Errors: the instance cannot go on",
    "logStatusFatal": "Errors that make every instance unusable",
    "statistics": "Work done by the integrator",
}
"""Categories of the log messages: name → what they tell."""


def model_description(
    model: SymbolicModel, guid: str, experiment: DefaultExperiment, source_files: tuple[str, ...]
) -> str:
    """The text of modelDescription.xml; without a date, so that equal models have equal descriptions.

    Args:
        model: what the FMU contains.
        guid: identity of its content; also compiled into the binary.
        experiment: proposed times and tolerance.
        source_files: C files below ``sources/`` from which the binary can be built again.

    Raises:
        ModelError: the model's variables contradict each other.
    """
    interface = build_interface(model)
    return render(
        "modelDescription.xml.j2",
        model=model,
        model_identifier=identifier(model.name),
        guid=guid,
        generation_tool=f"flexfmu {version('flexfmu')}",
        experiment=experiment,
        source_files=source_files,
        units=unit_definitions(variable.unit for variable in interface.variables if variable.unit is not None),
        initial_states=INITIAL_STATES,
        log_categories=LOG_CATEGORIES,
        max_input_order=MAX_INPUT_ORDER,
        max_output_order=MAX_OUTPUT_DERIVATIVE_ORDER,
        interface=interface,
    )
