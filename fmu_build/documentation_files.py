"""The documentation folder of any FMU: one HTML page that needs nothing else, and the licences."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

from flexfmu.fmu_build.description import LOG_CATEGORIES, Description
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.interface import FmiVariable
from flexfmu.fmu_build.labels import FONT_SIZE
from flexfmu.fmu_build.licences import LICENSE, copyright_line, licence_files
from flexfmu.fmu_build.picture import Picture
from flexfmu.fmu_build.templating import render
from flexfmu.fmu_build.units import displayed

_GROUPS = {
    "Inputs": ("input", "Real"),
    "Parameters": ("parameter", ""),
    "Outputs": ("output", "Real"),
    "Statistics": ("local", "Integer"),
    "Continuous states, for model exchange": ("local", "Real"),
}
"""Heading → causality and type of its variables, all types where none is named, in the order of the page."""


def documentation_files(
    template: str, description: Description, experiment: DefaultExperiment, *, picture: Picture, **values: Any
) -> dict[str, str]:
    """Files of the folder ``documentation/``: path below the FMU's root → text.

    Args:
        template: of the page; fills the blocks of ``page.html.j2``.
        description: what the model description says.
        experiment: default experiment.
        picture: drawn at the top of the page.
        values: whatever else the template shows.
    """
    page = render(
        template,
        about=description,
        experiment=experiment,
        picture=picture,
        font_size=FONT_SIZE,
        groups=_groups(description.interface.variables),
        start=_start_text,
        limits=_limits_text,
        log_categories=LOG_CATEGORIES,
        version=version("flexfmu"),
        copyright=copyright_line(),
        license=LICENSE,
        **values,
    )
    return {"documentation/index.html": page, **licence_files()}


def _groups(variables: Sequence[FmiVariable]) -> dict[str, list[FmiVariable]]:
    """Heading → its variables."""
    return {
        title: [each for each in variables if each.causality == causality and kind in (each.kind, "")]
        for title, (causality, kind) in _GROUPS.items()
    }


def _start_text(variable: FmiVariable, description: Description) -> str:
    """The start value with its unit, and as a person would rather read it; choices by name."""
    if variable.start is None:
        return ""
    for choice in description.choices:
        if choice.name == variable.name:
            return f"{choice.name_of(variable.start)} ({variable.start})"
    text = f"{variable.start:.12g} {variable.unit or ''}".strip()
    other = displayed(variable.start, variable.unit) if variable.unit and variable.start else None
    return f"{text} = {other}" if other else text


def _limits_text(variable: FmiVariable) -> str:
    """The admissible range, such as ``0 … 1000``; empty where there is none."""
    low, high = variable.minimum, variable.maximum
    if low is None and high is None:
        return ""
    return f"{'−∞' if low is None else f'{low:g}'} … {'∞' if high is None else f'{high:g}'}"
