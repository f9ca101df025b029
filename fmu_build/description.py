"""The model description (modelDescription.xml) of an FMI 2.0 FMU."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from typing import TYPE_CHECKING

from flexfmu.fmu_build.choices import INITIAL, INTEGRATOR, ChoiceParameter, annotation
from flexfmu.fmu_build.codegen import MAX_INPUT_ORDER, identifier
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.interface import Interface, build_interface
from flexfmu.fmu_build.naming import NAMES, Naming, named_interface, structured_names
from flexfmu.fmu_build.templating import render
from flexfmu.fmu_build.units import RealType, real_types, unit_definitions

if TYPE_CHECKING:
    from flexfmu.model.symbolic import SymbolicModel

AUTHOR = "the flexfmu authors"
LICENSE = "BSD-3-Clause, see documentation/licenses"

MAX_OUTPUT_DERIVATIVE_ORDER = 2
"""Highest order of output derivatives, which the runtime calculates exactly."""

LOG_CATEGORIES = {
    "logStatusWarning": "What went on with a reservation",
    "logStatusDiscard": "Steps that could not be made; a smaller one may work",
    "logStatusError": "Errors: the instance cannot go on",
    "logStatusFatal": "Errors that make every instance unusable",
    "statistics": "Work done since initialisation",
}
"""Log categories: name → description."""


@dataclass(frozen=True)
class Description:
    """The content of a model description, for any kind of FMU.

    Attributes:
        name: model name.
        text: one or two sentences for the user.
        interface: variables and structure.
        choices: parameters with named values.
        enumerations: whether these are FMI enumerations; otherwise Integers, which every importer accepts.
        max_input_order: highest order of input derivatives that may be set; 0 for none.
        max_output_order: highest order of output derivatives that can be read; 0 for none.
        has_tolerance: whether the FMU uses the tolerance of the default experiment.
        has_model_exchange: whether the FMU also supports model exchange, with directional derivatives.
        n_event_indicators: number of event indicators in model exchange.
        naming: naming convention of the variables.
        annotations: vendor annotations, element → attributes.

    Raises:
        ModelError: a variable has the name of a type.
    """

    name: str
    text: str
    interface: Interface
    choices: tuple[ChoiceParameter, ...] = ()
    enumerations: bool = False
    max_input_order: int = 0
    max_output_order: int = 0
    has_tolerance: bool = False
    has_model_exchange: bool = False
    n_event_indicators: int = 0
    naming: Naming = "structured"
    annotations: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        types = {each.name for each in self.real_types}
        types |= {each.type_name for each in self.choices if self.enumerations}
        for variable in self.interface.variables:
            if variable.name in types:
                raise ModelError(f"variable '{variable.name}' has the name of a type; give it another one")

    def named(self, naming: Naming) -> Description:
        """The description with names of variables by a convention; an annotation keeps the structured names.

        Raises:
            ModelError: a variable has no flat name, or two have the same.
        """
        if naming == "structured":
            return self
        names = {NAMES: structured_names(each.name for each in self.interface.variables)}
        interface = named_interface(self.interface, naming)
        return replace(self, interface=interface, naming=naming, annotations={**self.annotations, **names})

    @property
    def units(self) -> tuple[str, ...]:
        """Units of all variables that have one."""
        return tuple(variable.unit for variable in self.interface.variables if variable.unit is not None)

    @property
    def real_types(self) -> tuple[RealType, ...]:
        """Types of the real variables, one for each physical quantity."""
        return real_types(self.units)


def plant_description(model: SymbolicModel) -> Description:
    """The content of a plant's model description.

    Raises:
        ModelError: a name is repeated or unknown, or a start value is missing or out of range.
    """
    return Description(
        name=model.name,
        text=f"{model.description.rstrip('.')}. Inputs may carry derivatives up to order {MAX_INPUT_ORDER} "
        f"(fmi2SetRealInputDerivatives); output derivatives of orders 1 to {MAX_OUTPUT_DERIVATIVE_ORDER} are exact. For model exchange take an "
        f"implicit solver with error control (CVODE with BDF): the links' fast modes make explicit ones unstable at the step "
        f"size of the default experiment.",
        interface=build_interface(model),
        choices=(INITIAL, INTEGRATOR),
        max_input_order=MAX_INPUT_ORDER,
        max_output_order=MAX_OUTPUT_DERIVATIVE_ORDER,
        has_tolerance=True,
        has_model_exchange=True,
        n_event_indicators=len(model.frictions),
    )


def description_xml(
    description: Description, guid: str, experiment: DefaultExperiment, source_files: tuple[str, ...]
) -> str:
    """The text of modelDescription.xml, without a date, so that equal FMUs have equal descriptions.

    Args:
        description: content of the description.
        guid: GUID of the FMU, also compiled into the binary.
        experiment: default experiment.
        source_files: C files below ``sources/`` from which the binary can be built again.
    """
    # vendor annotations: input derivatives, choices, then those of the description
    derivatives = {"InputDerivatives": {"maxOrder": str(description.max_input_order)}}
    ordered: dict[str, Mapping[str, str]] = dict(derivatives) if description.max_input_order else {}
    return render(
        "modelDescription.xml.j2",
        name=description.name,
        description=description.text,
        model_identifier=identifier(description.name),
        guid=guid,
        author=AUTHOR,
        version=version("flexfmu"),
        copyright=copyright_line(),
        license=LICENSE,
        experiment=experiment,
        tolerance=experiment.tolerance if description.has_tolerance else None,
        source_files=source_files,
        units=unit_definitions(description.units),
        real_types=description.real_types,
        enumerations={each.name: each for each in description.choices if description.enumerations},
        log_categories=LOG_CATEGORIES,
        max_input_order=description.max_input_order,
        max_output_order=description.max_output_order,
        has_model_exchange=description.has_model_exchange,
        n_event_indicators=description.n_event_indicators,
        naming=description.naming,
        annotations=ordered | annotation(description.choices) | dict(description.annotations),
        interface=description.interface,
    )


def copyright_line() -> str:
    """The copyright line of the licence."""
    return next(line for line in render("license.txt").splitlines() if line.startswith("Copyright"))
