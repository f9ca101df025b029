"""Sources of an FMU from a model: C code, model description, documentation; and the GUID as their hash."""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import files

from flexfmu.fmu_build.block_build import block_content
from flexfmu.fmu_build.cache import content_hash
from flexfmu.fmu_build.choices import INITIAL, INTEGRATOR, LEAST_TOLERANCE
from flexfmu.fmu_build.codegen import LANES_FILE, MAX_INPUT_ORDER, generate_description, generate_functions, identifier
from flexfmu.fmu_build.description import Content, Description, description_xml, documentation
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.interface import build_interface, find_states
from flexfmu.fmu_build.naming import Naming, named, namer
from flexfmu.fmu_build.picture import plant_picture
from flexfmu.fmu_build.sources import ICON_FILES, Sources, c_files, runtime_sources
from flexfmu.fmu_build.toolchain import FmiVersion
from flexfmu.fmu_build.trajectory_build import Motion, motion_content
from flexfmu.model.symbolic import SymbolicBlock, SymbolicModel


def generate_sources(
    model: SymbolicModel | SymbolicBlock | Motion,
    experiment: DefaultExperiment,
    naming: Naming = "structured",
    enumerations: bool = False,
    fmi: FmiVersion = "2",
) -> Sources:
    """Generate all text files of an FMU; the GUID is the hash of C code and description with a blank GUID.

    Args:
        model: a plant, a block or a motion.
        experiment: default experiment.
        naming, enumerations, fmi: as for `flexfmu.fmu_build.build.build_fmu`.

    Raises:
        ModelError: the model violates its contract, or a C file of a block has the name of one of the runtime or a generated one.
    """
    # what this kind of FMU has of its own
    if isinstance(model, SymbolicBlock):
        content = block_content(model, naming)
    elif isinstance(model, Motion):
        content = motion_content(model, naming)
    else:
        content = _plant_content(model, naming, experiment)
    description = replace(content.description, naming=naming, enumerations=enumerations)
    icon = "block" if isinstance(model, SymbolicModel) and model.drawing is None else content.kind
    # C code with a blank GUID, and the runtime
    runtime, blank = runtime_sources(content.kind, fmi), content.code("")
    taken = sorted(set(content.c_files) & {*runtime, *blank})
    if taken:
        raise ModelError(
            f"the C file {taken[0]!r} has the name of a file of every FMU; rename it, to my_{taken[0]} for example"
        )
    joined = c_files(runtime)
    runtime |= content.c_files
    names = c_files((*blank, *runtime))
    # the hash of these texts, spelt {8-4-4-4-12}
    parts = (description_xml(description, "", experiment, names, fmi), *_flatten(blank), *_flatten(runtime))
    digits = content_hash(part.encode() for part in parts)
    guid = "{" + "-".join((digits[:8], digits[8:12], digits[12:16], digits[16:20], digits[20:32])) + "}"
    return Sources(
        identifier(description.name),
        guid,
        description_xml(description, guid, experiment, names, fmi),
        content.code(guid),
        runtime,
        documentation(content, naming, experiment, fmi),
        (files(__package__) / "templates" / f"{icon}.png").read_bytes(),
        ICON_FILES[fmi],
        content.libraries,
        joined,
    )


def _plant_content(model: SymbolicModel, naming: Naming, experiment: DefaultExperiment) -> Content:
    """What a plant's FMU has of its own.

    Raises:
        ModelError: the model violates its contract.
    """
    functions, facts = generate_functions(model)
    shown, has_lanes = named(model, naming), LANES_FILE in functions
    # states on the page
    states = [namer(naming)(model.outputs[k].name) for k in find_states(model).outputs]
    return Content(
        "plant",
        plant_description(model),
        functions,
        lambda guid: generate_description(shown, facts, guid, experiment.tolerance, has_lanes=has_lanes),
        "index.html.j2",
        picture=plant_picture(model.drawing),
        values={
            "model": shown,
            "states": states,
            "initial_states": INITIAL.items,
            "integrators": INTEGRATOR.items,
            "least_tolerance": LEAST_TOLERANCE,
        },
    )


MAX_OUTPUT_DERIVATIVE_ORDER = 2
"""Highest order of a plant's output derivatives, which the runtime calculates exactly."""


_ADVICE = (
    " For model exchange take an implicit solver with error control (CVODE with BDF): the links' fast modes make explicit ones unstable "
    "at the step size of the default experiment."
)


def plant_description(model: SymbolicModel) -> Description:
    """The content of a plant's model description.

    Raises:
        ModelError: a name is repeated or unknown, or a start value is missing or out of range.
    """
    return Description(
        name=model.name,
        text=f"{model.description.rstrip('.')}. Inputs may carry derivatives up to order {MAX_INPUT_ORDER} "
        f"(fmi2SetRealInputDerivatives); output derivatives of orders 1 to {MAX_OUTPUT_DERIVATIVE_ORDER} are exact.{'' if model.nominals else _ADVICE}",
        interface=build_interface(model),
        choices=(INTEGRATOR,) if model.nominals else (INITIAL, INTEGRATOR),
        max_input_order=MAX_INPUT_ORDER,
        max_output_order=MAX_OUTPUT_DERIVATIVE_ORDER,
        has_tolerance=True,
        has_model_exchange=True,
        n_event_indicators=len(model.frictions) + len(model.events),
    )


def _flatten(texts: dict[str, str]) -> tuple[str, ...]:
    return tuple(part for name in sorted(texts) for part in (name, texts[name]))
