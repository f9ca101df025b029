"""What an FMU says of itself: modelDescription.xml, and the folder ``documentation/`` with one HTML page and the licences of the content."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

from flexfmu.fmu_build.choices import ChoiceParameter, annotation
from flexfmu.fmu_build.codegen import DESCRIPTION_FILE, identifier
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.interface import FmiVariable, Interface, unique_interface
from flexfmu.fmu_build.naming import NAMES, Naming, namer, structured_names
from flexfmu.fmu_build.picture import FONT_SIZE, Picture
from flexfmu.fmu_build.sources import FmuKind
from flexfmu.fmu_build.templating import render
from flexfmu.fmu_build.toolchain import FMI_HEADERS, FmiVersion, fmi_header_folder
from flexfmu.fmu_build.units import RealType, displayed, real_types, unit_definitions
from flexfmu.model.symbolic import SharedLibrary

TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
"""Path of FMI 3.0's terminals, which name the variables that belong together."""


AUTHOR = "the flexfmu authors"
LICENSE = "BSD-3-Clause, see documentation/licenses"

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
        naming: naming convention of the variables in the file; an annotation keeps the structured names there.
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

    @property
    def units(self) -> tuple[str, ...]:
        """Units of all variables that have one."""
        return tuple(variable.unit for variable in self.interface.variables if variable.unit is not None)

    @property
    def real_types(self) -> tuple[RealType, ...]:
        """Types of the real variables, one for each physical quantity."""
        return real_types(self.units)


@dataclass(frozen=True)
class Content:
    """What one kind of FMU has of its own; archive, documentation, GUID and build are the same for all.

    Attributes:
        kind: kind of the FMU, which selects the runtime.
        description: content of the model description, with structured names.
        functions: generated C files without names of variables, name → text.
        tables: function from a GUID to the generated C file with the names and the GUID.
        page: template of the documentation's page, which extends ``page.html.j2``.
        picture: picture at the top of the page.
        values: further variables of the template.
        c_files: further C files and headers, whose functions the generated ones call, name → text.
        libraries: shared libraries that the FMU's own one needs beside it, name → library.
    """

    kind: FmuKind
    description: Description
    functions: Mapping[str, str]
    tables: Callable[[str], str]
    page: str
    picture: Picture
    values: Mapping[str, Any] = field(default_factory=dict)
    c_files: Mapping[str, str] = field(default_factory=dict)
    libraries: Mapping[str, SharedLibrary] = field(default_factory=dict)

    def code(self, guid: str) -> dict[str, str]:
        """The generated C files, name → text."""
        return {**self.functions, DESCRIPTION_FILE: self.tables(guid)}


def description_xml(
    description: Description,
    guid: str,
    experiment: DefaultExperiment,
    source_files: tuple[str, ...],
    fmi: FmiVersion = "2",
) -> str:
    """The text of modelDescription.xml, without a date, so that equal FMUs have equal descriptions.

    Args:
        description: content of the description.
        guid: GUID of the FMU, also compiled into the binary.
        experiment: default experiment.
        source_files: C files below ``sources/`` from which the binary can be built again; FMI 3.0 has them in the build description.
        fmi: version of FMI.

    Raises:
        ModelError: a variable has no flat name, or that of another one, if these are asked for.
    """
    # vendor annotations: input derivatives, choices, then those of the description
    derivatives = {"InputDerivatives": {"maxOrder": str(description.max_input_order)}}
    annotations: dict[str, Mapping[str, str]] = dict(derivatives) if description.max_input_order else {}
    annotations |= annotation(description.choices) | dict(description.annotations)
    # variables and structure by the version
    interface = description.interface
    variables, more = interface.variables, {}
    structure: Mapping[str, Mapping[int, Any]] = interface.structure()
    if fmi == "3":
        unique = unique_interface(
            interface, description.n_event_indicators, description.max_input_order, has_clock="Sampling" in annotations
        )
        variables, parts = unique.variables, interface.structure(unique.references)
        names = {"Outputs": "Output", "Derivatives": "ContinuousStateDerivative", "InitialUnknowns": "InitialUnknown"}
        structure = {names[part]: unknowns for part, unknowns in parts.items()} | {
            "EventIndicator": dict.fromkeys(unique.indicators)
        }
        if "Sampling" in annotations:
            structure = {**structure, "InitialUnknown": {}}  # what a clock samples isn't there before
        # events of friction change rates
        states = {unique.references[each.derivative] for each in variables if each.derivative}
        more = {"references": unique.references, "reinitialised": states if description.n_event_indicators else ()}
    if description.naming == "flat":
        annotations[NAMES] = structured_names(each.name for each in variables)
    return render(
        "modelDescription.xml.j2" if fmi == "2" else "modelDescription3.xml.j2",
        name=description.name,
        description=by_version(description.text, fmi),
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
        name_of=namer(description.naming),
        annotations=annotations,
        variables=variables,
        structure=structure,
        **more,
    )


_FMI3_TERMS = {
    "fmi2SetRealInputDerivatives": "the arrays derivatives.*",
    "fmi2GetRealOutputDerivatives": "fmi3GetOutputDerivatives",
    "fmi2SetupExperiment": "fmi3EnterInitializationMode",
    "FMI 2.0": "FMI 3.0",
}
"""What texts for FMI 2.0 call the same in FMI 3.0."""


def by_version(text: str, fmi: FmiVersion) -> str:
    """A text for FMI 2.0 with the terms of a version."""
    for term, other in _FMI3_TERMS.items() if fmi == "3" else ():
        text = text.replace(term, other)
    return text


def copyright_line() -> str:
    """The copyright line of the licence."""
    return next(line for line in render("license.txt").splitlines() if line.startswith("Copyright"))


_GROUPS = {
    "Inputs": ("input", "Real"),
    "Parameters": ("parameter", ""),
    "Outputs": ("output", "Real"),
    "Statistics": ("local", "Integer"),
    "Continuous states, for model exchange": ("local", "Real"),
}
"""Heading → causality and type of its variables (all types if empty), in the order of the page."""

_CASADI = """Of the files model_*.c in the folder sources/ that CasADi (https://casadi.org) has generated.

CasADi's copyright holders claim no ownership of generated code; what comes from CasADi's own templates is under the
MIT No Attribution licence (https://github.com/casadi/casadi/issues/3015).
"""


def documentation(
    content: Content, naming: Naming, experiment: DefaultExperiment, fmi: FmiVersion = "2"
) -> dict[str, str]:
    """Files of the folder ``documentation/`` of any FMU, and `TERMINALS` of FMI 3.0: path below the FMU's root → text."""
    variables = content.description.interface.variables
    page = render(
        content.page,
        about=content.description,
        naming=naming,
        name_of=namer(naming),
        experiment=experiment,
        picture=content.picture,
        font_size=FONT_SIZE,
        groups={
            title: [each for each in variables if each.causality == causality and kind in (each.kind, "")]
            for title, (causality, kind) in _GROUPS.items()
        },
        start=_start_text,
        limits=_limits_text,
        log_categories=LOG_CATEGORIES,
        version=version("flexfmu"),
        copyright=copyright_line(),
        license=LICENSE,
        **content.values,
    )
    # in FMI 3.0 the terminals: inputs and outputs by the component that they belong to, joint1.reference for example
    further = {}
    if fmi == "3":
        terminals: dict[str, dict[str, str]] = {}
        for each in variables:
            component, _, member = each.name.rpartition(".")
            if each.causality in ("input", "output") and component and not component.startswith("der("):
                terminals.setdefault(component, {})[member] = each.name
        template = "terminalsAndIcons.xml.j2"
        further[TERMINALS] = render(template, terminals=terminals, name_of=namer(naming))
    # licences of the content
    licences = {"license": render("license.txt"), "fmi-headers": _header_licence(fmi), "casadi-generated": _CASADI}
    return {
        "documentation/index.html": by_version(page, fmi),
        **further,
        **{f"documentation/licenses/{name}.txt": text for name, text in licences.items()},
    }


def _start_text(variable: FmiVariable, description: Description) -> str:
    """The start value with its unit, also in its display unit; the name for a choice."""
    if variable.start is None:
        return ""
    for choice in description.choices:
        if choice.name == variable.name:
            return f"{choice.name_of(variable.start)} ({variable.start})"
    text = f"{variable.start:.12g} {variable.unit or ''}".strip()
    other = displayed(variable.start, variable.unit) if variable.unit and variable.start else None
    return f"{text} = {other}" if other else text


def _limits_text(variable: FmiVariable) -> str:
    """The range, such as ``0 … 1000``; empty without bounds."""
    low, high = variable.minimum, variable.maximum
    if low is None and high is None:
        return ""
    return f"{'−∞' if low is None else f'{low:g}'} … {'∞' if high is None else f'{high:g}'}"


def _header_licence(fmi: FmiVersion) -> str:
    """The licence of the FMI standard's headers, copied from the first of them."""
    header = (fmi_header_folder() / FMI_HEADERS[fmi][0]).read_text(encoding="utf-8")
    found = re.search(r"^[ ]*Copyright.*?^[ ]*-{20,}.*?^[ ]*-{20,}", header, re.MULTILINE | re.DOTALL)
    text = found.group() if found else header
    return f"Of the FMI standard: {', '.join(FMI_HEADERS[fmi])} in the folder sources/.\n\n{text}\n"
