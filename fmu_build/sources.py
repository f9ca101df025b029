"""The text files of an FMU: C sources, model description, documentation; and the GUID as their hash."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from importlib.resources import files
from typing import Literal

from flexfmu.fmu_build.block_build import block_content
from flexfmu.fmu_build.cache import content_hash
from flexfmu.fmu_build.choices import INITIAL, INTEGRATOR, LEAST_TOLERANCE
from flexfmu.fmu_build.codegen import LANES_FILE, MAX_INPUT_ORDER, generate_description, generate_functions, identifier
from flexfmu.fmu_build.description import Content, Description, FmuKind, description_xml, documentation
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.interface import build_interface, find_states
from flexfmu.fmu_build.naming import Naming, named, namer
from flexfmu.fmu_build.picture import plant_picture
from flexfmu.fmu_build.templating import render
from flexfmu.fmu_build.toolchain import COMMON_FLAGS, FMI_HEADERS, SOLVER_FOLDERS, FmiVersion, fmi_header_folder
from flexfmu.fmu_build.trajectory_build import Motion, motion_content
from flexfmu.model.symbolic import SharedLibrary, SymbolicBlock, SymbolicModel

ICON_FILES: Mapping[FmiVersion, str] = {"2": "model.png", "3": "terminalsAndIcons/icon.png"}
"""Path of the icon in the FMU (FMI 2.0.4, section 2.3; FMI 3.0, section 2.5)."""

RuntimeKind = FmuKind | Literal["batch", "elementary", "processor"]
"""What the C runtime is compiled for."""

BUILD_DESCRIPTION = "sources/buildDescription.xml"
"""Path of FMI 3.0's build description, which tools for FMI 2.0 read too."""

OPTIONS = ("-O2", *COMMON_FLAGS)
"""Options for GCC and Clang that reproduce the numbers of the binaries; other compilers only need C99."""

_FOLDERS: Mapping[str, tuple[str, ...]] = {
    "plant": (*SOLVER_FOLDERS, "plant"),
    "block": ("base", "inputs", "math", "block"),
    "trajectory": ("base", "math", "trajectory"),
    "batch": (*SOLVER_FOLDERS, "batch"),
    "elementary": ("math", "lanes"),
    "processor": ("lanes",),
}
"""What is compiled → folders of ``c-runtime`` that it needs; their files lie side by side in an FMU."""

_FMI_FOLDERS: Mapping[tuple[str, FmiVersion], tuple[str, ...]] = {
    ("plant", "2"): ("fmi", "exchange", "fmi2", "fmi2-exchange"),
    ("block", "2"): ("fmi", "no-exchange", "fmi2"),
    ("trajectory", "2"): ("fmi", "no-exchange", "fmi2"),
    ("plant", "3"): ("fmi", "exchange", "fmi3"),
    ("block", "3"): ("fmi", "exchange", "no-exchange", "fmi3"),
    ("trajectory", "3"): ("fmi", "exchange", "no-exchange", "fmi3"),
}
"""Kind of FMU and version of FMI → further folders."""

_SHARED = ("fmi", "exchange")
"""Folders that both versions have, written in the words of FMI 2.0."""

_FMI3_TEXTS = (
    ("fmi2Component", "fmi3Instance"),
    ("fmi2GetRealOutputDerivatives", "fmi3GetOutputDerivatives"),
    *((f"fmi2{verb}Real", f"fmi3{verb}Float64") for verb in ("Get", "Set", "")),
    *((f"fmi2{verb}Integer", f"fmi3{verb}Int32") for verb in ("Get", "Set", "")),
    ("fmi2GetDerivatives", "fmi3GetContinuousStateDerivatives"),
    ("FMUstate", "FMUState"),
    ("DeSerialize", "Deserialize"),
    ("the GUID", "the instantiation token"),
    ('"step complete"', '"step mode"'),
    ("FMI2", "FMI3"),
    ("fmi2", "fmi3"),
)
"""What makes code in the words of FMI 3.0 of that in the words of FMI 2.0."""


@dataclass(frozen=True)
class Sources:
    """The content of an FMU before compilation.

    Attributes:
        model_identifier: name of the shared library.
        guid: hash of the content, as {8-4-4-4-12} hexadecimal digits.
        description: text of modelDescription.xml.
        generated: C files of the model, name → text.
        runtime: C files and headers of the runtime, name → text.
        documentation: path below the FMU's root → text.
        icon: PNG file; may be empty.
        icon_file: path of the icon below the FMU's root.
        libraries: shared libraries that the FMU's own one needs beside it, name → library.
        joined: C files of ``runtime`` that may be compiled as one, since none has a name that another defines for itself.
    """

    model_identifier: str
    guid: str
    description: str
    generated: dict[str, str]
    runtime: dict[str, str]
    documentation: dict[str, str]
    icon: bytes = b""
    icon_file: str = ICON_FILES["2"]
    libraries: Mapping[str, SharedLibrary] = field(default_factory=dict)
    joined: tuple[str, ...] = ()

    def archive_files(self) -> dict[str, bytes]:
        """Path below the FMU's root → content, without binaries."""
        code = {f"sources/{name}": text for name, text in (self.generated | self.runtime).items()}
        # build description for tools that compile the sources
        rebuild = render(
            "buildDescription.xml.j2",
            model_identifier=self.model_identifier,
            source_files=c_files((*self.generated, *self.runtime)),
            options=" ".join(OPTIONS),
        )
        texts = {"modelDescription.xml": self.description, BUILD_DESCRIPTION: rebuild} | code | self.documentation
        return {path: text.encode() for path, text in texts.items()} | (
            {self.icon_file: self.icon} if self.icon else {}
        )


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


def runtime_sources(kind: RuntimeKind = "plant", fmi: FmiVersion = "2") -> dict[str, str]:
    """C files and headers of the runtime, name → text, with the standard's headers where it has the FMI layer.

    Args:
        kind: kind of FMU; ``batch``: the solver of variants in lockstep, without FMI; ``elementary``: the functions (sin, exp, ...),
            scalar and on lanes, that generated code calls; ``processor``: tells how many lanes this processor has.
        fmi: version of FMI.
    """
    root = files("flexfmu.fmu_build") / "c-runtime"
    layer = _FMI_FOLDERS.get((kind, fmi), ())
    headers = [fmi_header_folder() / name for name in FMI_HEADERS[fmi]] if layer else []
    texts = {entry.name: entry.read_text(encoding="utf-8") for entry in headers}
    for folder in (*_FOLDERS[kind], *layer):
        for entry in (root / folder).iterdir():
            if entry.name.endswith((".c", ".h")):
                text = entry.read_text(encoding="utf-8")
                for old, new in _FMI3_TEXTS if fmi == "3" and folder in _SHARED else ():
                    text = text.replace(old, new)
                texts[entry.name] = text
    return dict(sorted(texts.items()))


def c_files(names: Iterable[str]) -> tuple[str, ...]:
    """The C files among ``names``, sorted."""
    return tuple(sorted(name for name in names if name.endswith(".c")))


def _flatten(texts: dict[str, str]) -> tuple[str, ...]:
    return tuple(part for name in sorted(texts) for part in (name, texts[name]))
