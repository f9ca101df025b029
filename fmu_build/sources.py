"""The text files of an FMU: C sources, model description, documentation; and the GUID as their hash."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from importlib.resources import files
from typing import TYPE_CHECKING, Literal

from flexfmu.fmu_build.cache import content_hash
from flexfmu.fmu_build.codegen import DESCRIPTION_FILE, LANES_FILE, generate_description, generate_functions, identifier
from flexfmu.fmu_build.description import Description, description_xml, plant_description
from flexfmu.fmu_build.documentation import documentation, plant_picture
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.naming import Naming, named_model
from flexfmu.fmu_build.picture import ICON_FILE, png
from flexfmu.fmu_build.templating import render
from flexfmu.fmu_build.toolchain import COMMON_FLAGS, FMI_HEADERS, fmi_header_folder

if TYPE_CHECKING:
    from flexfmu.model.symbolic import SharedLibrary, SymbolicModel

FmuKind = Literal["plant", "block", "trajectory"]
"""Kind of an FMU; all kinds share the FMI layer of the runtime."""

RuntimeKind = FmuKind | Literal["batch", "elementary", "processor"]
"""What the C runtime is compiled for."""

BUILD_DESCRIPTION = "sources/buildDescription.xml"
"""Path of FMI 3.0's build description, which tools for FMI 2.0 read too."""

OPTIONS = ("-O2", *COMMON_FLAGS)
"""Options for GCC and Clang that reproduce the numbers of the binaries; other compilers only need C99."""

_FOLDERS: Mapping[str, tuple[str, ...]] = {
    "plant": ("base", "fmi2", "inputs", "math", "lanes", "solver", "plant"),
    "block": ("base", "fmi2", "inputs", "math", "block"),
    "trajectory": ("base", "fmi2", "math", "trajectory"),
    "batch": ("base", "inputs", "math", "lanes", "solver", "batch"),
    "elementary": ("math", "lanes"),
    "processor": ("lanes",),
}
"""What is compiled → folders of ``c-runtime`` that it needs; their files lie side by side in an FMU."""


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
        libraries: shared libraries that the FMU's own one needs beside it, name → library.
    """

    model_identifier: str
    guid: str
    description: str
    generated: dict[str, str]
    runtime: dict[str, str]
    documentation: dict[str, str]
    icon: bytes = b""
    libraries: Mapping[str, SharedLibrary] = field(default_factory=dict)

    @property
    def generated_bytes(self) -> int:
        """Size of the generated C code [bytes]."""
        return sum(len(text.encode()) for text in self.generated.values())

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
        return {path: text.encode() for path, text in texts.items()} | ({ICON_FILE: self.icon} if self.icon else {})


def generate_sources(
    model: SymbolicModel, experiment: DefaultExperiment, naming: Naming = "structured", enumerations: bool = False
) -> Sources:
    """Generate all text files of a plant's FMU.

    Raises:
        ModelError: the model violates its contract.
    """
    functions, facts = generate_functions(model)
    named = named_model(model, naming)

    # only the tables contain the GUID
    def code(guid: str) -> dict[str, str]:
        description = generate_description(named, facts, guid, experiment.tolerance, has_lanes=LANES_FILE in functions)
        return functions | {DESCRIPTION_FILE: description}

    # model description, documentation and icon
    description = replace(plant_description(model).named(naming), enumerations=enumerations)
    pages = documentation(named, description, experiment)
    return assemble_sources("plant", description, experiment, code, pages, png(plant_picture(model)))


def assemble_sources(
    kind: FmuKind,
    description: Description,
    experiment: DefaultExperiment,
    code: Callable[[str], dict[str, str]],
    pages: dict[str, str],
    icon: bytes,
    called: Mapping[str, str] | None = None,
) -> Sources:
    """Assemble the files of an FMU; the GUID is the hash of C code and description with a blank GUID.

    Args:
        kind: kind of the FMU, which selects the runtime.
        description: content of the model description.
        experiment: default experiment.
        code: function from a GUID to the generated C files, name → text.
        pages: documentation, path below the FMU's root → text.
        icon: PNG file; may be empty.
        called: further C files and headers, whose functions the generated ones call, name → text.

    Raises:
        ModelError: a further file has the name of one of the runtime or a generated one.
    """
    # the GUID is the hash of the texts with a blank GUID
    runtime = runtime_sources(kind)
    blank = code("")
    taken = sorted(set(called or ()) & {*runtime, *blank})
    if taken:
        raise ModelError(
            f"the C file {taken[0]!r} has the name of a file of every FMU; rename it, to my_{taken[0]} for example"
        )
    runtime |= called or {}
    names = c_files((*blank, *runtime))
    blank_text = description_xml(description, "", experiment, names)
    guid = _guid((blank_text, *_flatten(blank), *_flatten(runtime)))
    text = description_xml(description, guid, experiment, names)
    return Sources(identifier(description.name), guid, text, code(guid), runtime, pages, icon)


def runtime_sources(kind: RuntimeKind = "plant") -> dict[str, str]:
    """C files and headers of the runtime, name → text, with the standard's headers where it has the FMI layer.

    Args:
        kind: kind of FMU; ``batch``: the solver of variants in lockstep, without FMI; ``elementary``: the functions (sin, exp, ...),
            scalar and on lanes, that generated code calls; ``processor``: tells how many lanes this processor has.
    """
    root = files("flexfmu.fmu_build") / "c-runtime"
    entries = [
        entry for folder in _FOLDERS[kind] for entry in (root / folder).iterdir() if entry.name.endswith((".c", ".h"))
    ]
    headers = [fmi_header_folder() / name for name in FMI_HEADERS] if "fmi2" in _FOLDERS[kind] else []
    ordered = sorted([*entries, *headers], key=lambda each: each.name)
    return {entry.name: entry.read_text(encoding="utf-8") for entry in ordered}


def c_files(names: Iterable[str]) -> tuple[str, ...]:
    """The C files among ``names``, sorted."""
    return tuple(sorted(name for name in names if name.endswith(".c")))


def _flatten(texts: dict[str, str]) -> tuple[str, ...]:
    return tuple(part for name in sorted(texts) for part in (name, texts[name]))


def _guid(parts: Iterable[str]) -> str:
    """Hash of ``parts`` in the spelling {8-4-4-4-12}."""
    text = content_hash(part.encode() for part in parts)
    return "{" + "-".join((text[:8], text[8:12], text[12:16], text[16:20], text[20:32])) + "}"
