"""The documentation folder of an FMU: one self-contained HTML page, and the licences of the content."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.metadata import version

from flexfmu.fmu_build.description import LICENSE, LOG_CATEGORIES, Content, Description, copyright_line
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.interface import FmiVariable
from flexfmu.fmu_build.naming import Naming, namer
from flexfmu.fmu_build.picture import FONT_SIZE
from flexfmu.fmu_build.templating import render
from flexfmu.fmu_build.toolchain import FMI_HEADERS, fmi_header_folder
from flexfmu.fmu_build.units import displayed

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


def documentation(content: Content, naming: Naming, experiment: DefaultExperiment) -> dict[str, str]:
    """Files of the folder ``documentation/`` of any FMU: path below the FMU's root → text."""
    page = render(
        content.page,
        about=content.description,
        naming=naming,
        name_of=namer(naming),
        experiment=experiment,
        picture=content.picture,
        font_size=FONT_SIZE,
        groups=_groups(content.description.interface.variables),
        start=_start_text,
        limits=_limits_text,
        log_categories=LOG_CATEGORIES,
        version=version("flexfmu"),
        copyright=copyright_line(),
        license=LICENSE,
        **content.values,
    )
    # licences of the content
    licences = {"license": render("license.txt"), "fmi-headers": _header_licence(), "casadi-generated": _CASADI}
    return {
        "documentation/index.html": page,
        **{f"documentation/licenses/{name}.txt": text for name, text in licences.items()},
    }


def _groups(variables: Sequence[FmiVariable]) -> dict[str, list[FmiVariable]]:
    """Heading → its variables."""
    return {
        title: [each for each in variables if each.causality == causality and kind in (each.kind, "")]
        for title, (causality, kind) in _GROUPS.items()
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


def _header_licence() -> str:
    """The licence of the FMI standard's headers, copied from the first of them."""
    header = (fmi_header_folder() / FMI_HEADERS[0]).read_text(encoding="utf-8")
    found = re.search(r"^[ ]*Copyright.*?^[ ]*-{20,}.*?^[ ]*-{20,}", header, re.MULTILINE | re.DOTALL)
    text = found.group() if found else header
    return f"Of the FMI standard: {', '.join(FMI_HEADERS)} in the folder sources/.\n\n{text}\n"
